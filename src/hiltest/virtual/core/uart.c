/* UARTs of Kinetis parts: bytes of ten bits, with their FIFOs, interrupts and DMA requests (K64 reference manual,
 * chapter "Universal Asynchronous Receiver/Transmitter"). The host is at the far end of the wires. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "devices.h"

enum { BDH = 0x0, BDL = 0x1, C2 = 0x3, S1 = 0x4, C3 = 0x6, D = 0x7, C4 = 0xA, C5 = 0xB };
enum { PFIFO = 0x10, CFIFO, SFIFO, TWFIFO, TCFIFO, RWFIFO, RCFIFO, REGISTERS = 0x20 };
enum { S1_TDRE = 0x80, S1_TC = 0x40, S1_RDRF = 0x20, S1_IDLE = 0x10, S1_OR = 0x08, S1_FE = 0x02 };
enum { C2_TE = 0x08, C2_RE = 0x04 };
enum { PFIFO_TXFE = 0x80, PFIFO_RXFE = 0x08, PFIFO_ENABLED = PFIFO_TXFE | PFIFO_RXFE, PFIFO_SIZES = 0x22 };
enum { CFIFO_TXFLUSH = 0x80, CFIFO_RXFLUSH = 0x40 };
enum { SFIFO_TXEMPT = 0x80, SFIFO_RXEMPT = 0x40, SFIFO_RXOF = 0x04, SFIFO_TXOF = 0x02, SFIFO_RXUF = 0x01 };
enum { SFIFO_FLAGS = SFIFO_RXOF | SFIFO_TXOF | SFIFO_RXUF };
enum { BITS_A_BYTE = 10, DEPTH = 8 };
static const double BAUD_TOLERANCE = 0.03; /* beyond this, the last bits are sampled during adjacent bits */
static const double PICOSECONDS = 1e12;

/* Bytes between the host and a UART: at most QUEUE_LIMIT of them. */
enum { QUEUE_LIMIT = 1 << 24, SMALLEST_CAPACITY = 256 };
struct queue {
    uint8_t *bytes;
    int32_t begin, count, capacity;
};

struct fifo {
    uint8_t bytes[DEPTH];
    int32_t count;
};

struct uart {
    struct device device;
    struct machine_uart connections;
    struct queue incoming, sent; /* bytes from the host, and unfetched bytes for it */
    bool has_lost;               /* sent bytes were lost */
    int32_t expected_count, expected_byte; /* see machine_uart_expect */
    double line_baud;            /* at the far end of the wires */
    int64_t line_byte_ps;
    struct event arrival;        /* of the first byte of `incoming` */
    struct event idle;           /* end of a byte's time of silence on the line */
    struct event end;            /* of the byte `shifting`; planned while there is one */
    uint8_t shifting;
    uint8_t flags, flags_seen;   /* of S1: IDLE, OR, FE; and the value at the last read */
    uint8_t registers[REGISTERS];
    struct fifo receive, transmit;
    int64_t heard_at, heard_awake; /* cycles, and cycles of the thread alone, at the last byte from the host */
    bool is_unanswered;          /* nothing was sent since then */
    struct machine_answer answer;
};

/* -- bytes of the host -------------------------------------------------------------------------------------------- */

/* Make room for `count` more bytes at the end. False if they are too many, or if out of memory. The memory is at least
 * twice as large as needed, so that each byte is moved at most once on average. */
static bool queue_reserve(struct queue *queue, int32_t count)
{
    if (count > QUEUE_LIMIT - queue->count)
        return false;
    if (queue->begin + queue->count + count <= queue->capacity)
        return true;
    if (queue->count)
        memmove(queue->bytes, queue->bytes + queue->begin, (size_t)queue->count);
    queue->begin = 0;
    const int32_t least = 2 * (queue->count + count);
    if (queue->capacity >= least)
        return true;
    const int32_t capacity = 2 * least > SMALLEST_CAPACITY ? 2 * least : SMALLEST_CAPACITY;
    uint8_t *bytes = realloc(queue->bytes, (size_t)capacity);
    if (!bytes)
        return false;
    queue->bytes = bytes;
    queue->capacity = capacity;
    return true;
}

/* Append a byte. False if no room was reserved. */
static bool queue_put(struct queue *queue, uint8_t byte)
{
    if (queue->begin + queue->count == queue->capacity)
        return false;
    queue->bytes[queue->begin + queue->count++] = byte;
    return true;
}

/* Remove at most `count` bytes from the beginning; return their number. */
static int32_t queue_take(struct queue *queue, uint8_t *bytes, int32_t count)
{
    const int32_t size = count < queue->count ? count : queue->count;
    if (size <= 0)
        return 0;
    memcpy(bytes, queue->bytes + queue->begin, (size_t)size);
    queue->begin += size;
    queue->count -= size;
    return size;
}

/* -- FIFOs -------------------------------------------------------------------------------------------------------- */

static void fifo_put(struct fifo *fifo, uint8_t byte) { fifo->bytes[fifo->count++] = byte; }

static uint8_t fifo_take(struct fifo *fifo)
{
    uint8_t byte = fifo->bytes[0];
    fifo->count--;
    memmove(fifo->bytes, fifo->bytes + 1, (size_t)fifo->count);
    return byte;
}

static int32_t depth_of(const struct uart *uart, uint8_t enabled)
{
    return uart->registers[PFIFO] & enabled ? uart->connections.depth : 1;
}

/* -- interrupts and requests -------------------------------------------------------------------------------------- */

static uint8_t status_of(const struct uart *uart)
{
    uint8_t status = uart->flags;
    if (uart->transmit.count <= uart->registers[TWFIFO])
        status |= S1_TDRE;
    if (!uart->transmit.count && !uart->end.is_planned)
        status |= S1_TC;
    if (uart->receive.count && uart->receive.count >= uart->registers[RWFIFO])
        status |= S1_RDRF;
    return status;
}

/* C2's TIE, TCIE, RIE and ILIE are at the bits of TDRE, TC, RDRF and IDLE in S1, and so are C5's TDMAS and RDMAS, which
 * turn TDRE and RDRF into DMA requests. */
static void drive(struct machine *machine, const struct uart *uart)
{
    const struct machine_uart *connections = &uart->connections;
    uint32_t asks = status_of(uart) & uart->registers[C2] & (S1_TDRE | S1_TC | S1_RDRF | S1_IDLE);
    uint32_t requests = asks & uart->registers[C5] & (S1_TDRE | S1_RDRF);
    machine_set_line(machine, connections->status_interrupt, asks & ~requests);
    machine_set_line(machine, connections->error_interrupt, uart->flags & uart->registers[C3] & 0x0F);
    if (connections->receive_request == connections->send_request) {
        machine_set_request(machine, connections->send_request, requests);
    } else {
        machine_set_request(machine, connections->receive_request, requests & S1_RDRF);
        machine_set_request(machine, connections->send_request, requests & S1_TDRE);
    }
}

/* -- rates -------------------------------------------------------------------------------------------------------- */

/* Return the divisor of the module clock, in 32nds, for 16 times the rate. */
static int64_t divisor_of(const struct uart *uart)
{
    return ((uart->registers[BDH] & 0x1F) << 8 | uart->registers[BDL]) * 32 + (uart->registers[C4] & 0x1F);
}

static double baud_of(const struct machine *machine, const struct uart *uart)
{
    const struct clock *clock = &machine->calendar.clocks[uart->connections.clock];
    const struct clock *time = &machine->calendar.clocks[uart->connections.time];
    int64_t divisor = divisor_of(uart);
    if (divisor < 32 || !time->numerator)
        return 0;
    double ticks = (double)clock->numerator * (double)time->denominator * PICOSECONDS;
    return ticks / ((double)clock->denominator * (double)time->numerator) * 2 / (double)divisor;
}

static bool is_garbled(const struct machine *machine, const struct uart *uart)
{
    return fabs(baud_of(machine, uart) / uart->line_baud - 1) > BAUD_TOLERANCE;
}

/* -- receiving ---------------------------------------------------------------------------------------------------- */

/* The module is stopped in STOP. */
static bool listens(const struct machine *machine, const struct uart *uart)
{
    bool runs = uart->device.is_clocked && machine->calendar.clocks[uart->connections.clock].numerator;
    return runs && uart->registers[C2] & C2_RE;
}

static void receive(struct machine *machine, struct uart *uart, uint8_t byte)
{
    if (is_garbled(machine, uart)) {
        byte ^= 0xFF;
        uart->flags |= S1_FE;
    }
    if (uart->receive.count < depth_of(uart, PFIFO_RXFE)) {
        fifo_put(&uart->receive, byte);
    } else {
        uart->flags |= S1_OR;
        uart->registers[SFIFO] |= SFIFO_RXOF;
    }
}

/* Cycles in which the thread executed: neither asleep nor in exceptions. */
static int64_t awake_cycles(const struct core *core)
{
    int64_t exceptions = core->exception_cycles
        + (core->exception == EXCEPTION_NONE ? 0 : core->cycles - core->exception_since);
    return core->cycles - core->idle_cycles - exceptions;
}

static void arrive(struct machine *machine, struct event *event)
{
    struct uart *uart = OWNER(event, struct uart, arrival);
    int64_t next = event->tick + uart->line_byte_ps;
    uint8_t byte = 0;
    if (queue_take(&uart->incoming, &byte, 1) && listens(machine, uart))
        receive(machine, uart, byte);
    uart->heard_at = machine->core.cycles;
    uart->heard_awake = awake_cycles(&machine->core);
    uart->is_unanswered = true;
    plan_event_at_tick(machine, uart->incoming.count ? &uart->arrival : &uart->idle, uart->connections.time, next);
    drive(machine, uart);
}

static void be_idle(struct machine *machine, struct event *event)
{
    struct uart *uart = OWNER(event, struct uart, idle);
    if (uart->arrival.is_planned)
        return;
    uart->flags |= S1_IDLE;
    drive(machine, uart);
}

/* -- sending ------------------------------------------------------------------------------------------------------ */

/* Put the next byte on the line at a tick of the module clock. */
static void shift(struct machine *machine, struct uart *uart, int64_t tick)
{
    uart->shifting = fifo_take(&uart->transmit);
    plan_event_at_tick(machine, &uart->end, uart->connections.clock, tick + BITS_A_BYTE * divisor_of(uart) / 2);
}

static void end_byte(struct machine *machine, struct event *event)
{
    struct uart *uart = OWNER(event, struct uart, end);
    uint8_t byte = is_garbled(machine, uart) ? uart->shifting ^ 0xFF : uart->shifting;
    if (!queue_put(&uart->sent, byte))
        uart->has_lost = true;
    if (uart->sent.count >= uart->expected_count || byte == uart->expected_byte)
        notify_host(machine);
    if (uart->transmit.count)
        shift(machine, uart, event->tick);
    drive(machine, uart);
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static void reset(struct machine *machine, struct device *device)
{
    struct uart *uart = (struct uart *)device;
    cancel_event(machine, &uart->end);
    cancel_event(machine, &uart->idle); /* bytes continue to arrive, at a disabled receiver */
    memset(uart->registers, 0, sizeof uart->registers);
    uart->registers[BDL] = 0x04;
    uart->registers[PFIFO] = uart->connections.depth == DEPTH ? PFIFO_SIZES : 0; /* 8 bytes each */
    uart->registers[RWFIFO] = 1;
    uart->receive.count = uart->transmit.count = 0;
    uart->flags = uart->flags_seen = 0;
    drive(machine, uart);
}

/* A read of S1 followed by a read of D clears the flags that S1 showed. */
static uint8_t read_data(struct machine *machine, struct uart *uart)
{
    uint8_t byte = 0;
    uart->flags &= (uint8_t)~uart->flags_seen;
    uart->flags_seen = 0;
    if (uart->receive.count)
        byte = fifo_take(&uart->receive);
    else
        uart->registers[SFIFO] |= SFIFO_RXUF;
    drive(machine, uart);
    return byte;
}

static uint8_t read_register(struct machine *machine, struct device *device, uint32_t offset)
{
    struct uart *uart = (struct uart *)device;
    switch (offset) {
    case S1:
        uart->flags_seen = uart->flags;
        return status_of(uart);
    case D: return read_data(machine, uart);
    case SFIFO:
        return (uint8_t)(uart->registers[SFIFO] | (uart->receive.count ? 0 : SFIFO_RXEMPT)
            | (uart->transmit.count ? 0 : SFIFO_TXEMPT));
    case TCFIFO: return (uint8_t)uart->transmit.count;
    case RCFIFO: return (uint8_t)uart->receive.count;
    default: return offset < REGISTERS ? uart->registers[offset] : 0;
    }
}

/* Room for the byte at the host is reserved here, so that no event needs memory. */
static void write_data(struct machine *machine, struct uart *uart, uint8_t byte)
{
    if (!(uart->registers[C2] & C2_TE))
        return;
    if (uart->transmit.count >= depth_of(uart, PFIFO_TXFE)) {
        uart->registers[SFIFO] |= SFIFO_TXOF;
        return;
    }
    if (uart->is_unanswered) {
        uart->answer.cycles = machine->core.cycles - uart->heard_at;
        uart->answer.awake_cycles = awake_cycles(&machine->core) - uart->heard_awake;
        uart->is_unanswered = false;
    }
    fifo_put(&uart->transmit, byte);
    queue_reserve(&uart->sent, uart->transmit.count + 1);
    if (!uart->end.is_planned)
        shift(machine, uart, ticks_now(machine, uart->connections.clock));
}

static void write_register(struct machine *machine, struct device *device, uint32_t offset, uint8_t value)
{
    struct uart *uart = (struct uart *)device;
    switch (offset) {
    case D: write_data(machine, uart, value); break;
    case CFIFO:
        if (value & CFIFO_TXFLUSH)
            uart->transmit.count = 0;
        if (value & CFIFO_RXFLUSH)
            uart->receive.count = 0;
        uart->registers[CFIFO] = value & 0x07;
        break;
    case SFIFO: uart->registers[SFIFO] &= (uint8_t)(~value & SFIFO_FLAGS); break;
    case PFIFO:
        uart->registers[PFIFO] = (uint8_t)((value & PFIFO_ENABLED) | (uart->registers[PFIFO] & PFIFO_SIZES));
        break;
    case S1: case TCFIFO: case RCFIFO: break;
    default:
        if (offset < REGISTERS)
            uart->registers[offset] = value;
    }
    drive(machine, uart);
}

/* -- the host ----------------------------------------------------------------------------------------------------- */

static void destroy(struct device *device)
{
    struct uart *uart = (struct uart *)device;
    free(uart->incoming.bytes);
    free(uart->sent.bytes);
}

/* Bytes between host and board are not part of the state: afterwards none is in transit. */
static void restore(struct device *device, const void *state)
{
    struct uart *uart = (struct uart *)device;
    const struct queue incoming = uart->incoming, sent = uart->sent;
    memcpy(uart, state, sizeof *uart);
    uart->incoming = incoming;
    uart->sent = sent;
    uart->incoming.count = uart->sent.count = 0;
}

bool machine_add_uart(struct machine *machine, uint32_t base, struct machine_uart connections)
{
    const struct uart uart = {
        .device = {
            .base = base, .bytes = PAGE_BYTES, .read = read_by_bytes, .read_byte = read_register,
            .write = write_by_bytes, .write_byte = write_register, .reset = reset, .destroy = destroy,
            .restore = restore},
        .connections = connections, .expected_count = INT32_MAX, .expected_byte = -1,
        .arrival.fire = arrive, .idle.fire = be_idle, .end.fire = end_byte};
    return add_device(machine, &uart.device, sizeof uart);
}

static struct uart *uart_of(const struct machine *machine, uint32_t base)
{
    return (struct uart *)device_of(machine, base);
}

void machine_set_line_baud(struct machine *machine, uint32_t base, double baud, int64_t byte_ps)
{
    struct uart *uart = uart_of(machine, base);
    uart->line_baud = baud;
    uart->line_byte_ps = byte_ps;
}

double machine_uart_baud(struct machine *machine, uint32_t base) { return baud_of(machine, uart_of(machine, base)); }

bool machine_uart_write(struct machine *machine, uint32_t base, const uint8_t *bytes, int32_t count)
{
    struct uart *uart = uart_of(machine, base);
    if (!queue_reserve(&uart->incoming, count))
        return false;
    for (int32_t i = 0; i < count; i++)
        queue_put(&uart->incoming, bytes[i]);
    int32_t time = uart->connections.time;
    if (uart->incoming.count && !uart->arrival.is_planned)
        plan_event_at_tick(machine, &uart->arrival, time, ticks_now(machine, time) + uart->line_byte_ps);
    return true;
}

void machine_uart_expect(struct machine *machine, uint32_t base, int32_t count, int32_t byte)
{
    struct uart *uart = uart_of(machine, base);
    uart->expected_count = count;
    uart->expected_byte = byte;
}

int32_t machine_uart_arriving(struct machine *machine, uint32_t base) { return uart_of(machine, base)->incoming.count; }

int32_t machine_uart_waiting(struct machine *machine, uint32_t base) { return uart_of(machine, base)->sent.count; }

struct machine_answer machine_uart_answer(struct machine *machine, uint32_t base)
{
    return uart_of(machine, base)->answer;
}

int32_t machine_uart_read(struct machine *machine, uint32_t base, uint8_t *bytes, int32_t count)
{
    struct uart *uart = uart_of(machine, base);
    return uart->has_lost ? -1 : queue_take(&uart->sent, bytes, count);
}
