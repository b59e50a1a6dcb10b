/* UARTs of Kinetis parts: bytes of ten bits, with their FIFOs, interrupts and DMA requests (K64 reference manual,
 * chapter "Universal Asynchronous Receiver/Transmitter"). The host is at the far end of the wires. */
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

struct fifo {
    uint8_t bytes[DEPTH];
    int32_t count;
};

struct uart {
    struct serial serial;
    struct event end;            /* of the byte `shifting`; planned while there is one */
    uint8_t shifting;
    uint8_t flags, flags_seen;   /* of S1: IDLE, OR, FE; and the value at the last read */
    uint8_t registers[REGISTERS];
    struct fifo receive, transmit;
};

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
    return uart->registers[PFIFO] & enabled ? uart->serial.connections.depth : 1;
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
    const struct machine_uart *connections = &uart->serial.connections;
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

static double bit_ticks(const struct serial *serial)
{
    int64_t divisor = divisor_of((const struct uart *)serial);
    return divisor < 32 ? 0 : (double)divisor / 2;
}

/* -- receiving ---------------------------------------------------------------------------------------------------- */

/* The module is stopped in STOP. */
static bool listens(const struct machine *machine, const struct uart *uart)
{
    bool runs = uart->serial.device.is_clocked && machine->calendar.clocks[uart->serial.connections.clock].numerator;
    return runs && uart->registers[C2] & C2_RE;
}

static void receive(struct machine *machine, struct uart *uart, uint8_t byte)
{
    if (is_garbled(machine, &uart->serial)) {
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

static void arrive(struct machine *machine, struct serial *serial, uint8_t byte)
{
    struct uart *uart = (struct uart *)serial;
    if (listens(machine, uart))
        receive(machine, uart, byte);
    drive(machine, uart);
}

static void be_idle(struct machine *machine, struct serial *serial)
{
    struct uart *uart = (struct uart *)serial;
    uart->flags |= S1_IDLE;
    drive(machine, uart);
}

/* -- sending ------------------------------------------------------------------------------------------------------ */

/* Put the next byte on the line at a tick of the module clock. */
static void shift(struct machine *machine, struct uart *uart, int64_t tick)
{
    uart->shifting = fifo_take(&uart->transmit);
    plan_event_at_tick(machine, &uart->end, uart->serial.connections.clock, tick + BITS_A_BYTE * divisor_of(uart) / 2);
}

static void end_byte(struct machine *machine, struct event *event)
{
    struct uart *uart = OWNER(event, struct uart, end);
    pass_to_host(machine, &uart->serial, uart->shifting);
    if (uart->transmit.count)
        shift(machine, uart, event->tick);
    drive(machine, uart);
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static void reset(struct machine *machine, struct device *device)
{
    struct uart *uart = (struct uart *)device;
    cancel_event(machine, &uart->end);
    cancel_event(machine, &uart->serial.idle); /* bytes continue to arrive, at a disabled receiver */
    memset(uart->registers, 0, sizeof uart->registers);
    uart->registers[BDL] = 0x04;
    uart->registers[PFIFO] = uart->serial.connections.depth == DEPTH ? PFIFO_SIZES : 0; /* 8 bytes each */
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

static void write_data(struct machine *machine, struct uart *uart, uint8_t byte)
{
    if (!(uart->registers[C2] & C2_TE))
        return;
    if (uart->transmit.count >= depth_of(uart, PFIFO_TXFE)) {
        uart->registers[SFIFO] |= SFIFO_TXOF;
        return;
    }
    fifo_put(&uart->transmit, byte);
    expect_sent(machine, &uart->serial, uart->transmit.count + 1);
    if (!uart->end.is_planned)
        shift(machine, uart, ticks_now(machine, uart->serial.connections.clock));
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

bool machine_add_uart(struct machine *machine, uint32_t base, struct machine_uart connections)
{
    struct uart uart = {
        .serial.device = {
            .base = base, .bytes = PAGE_BYTES, .read = read_by_bytes, .read_byte = read_register,
            .write = write_by_bytes, .write_byte = write_register, .reset = reset},
        .serial.arrived = arrive, .serial.fell_silent = be_idle, .serial.bit_ticks = bit_ticks, .end.fire = end_byte};
    begin_serial(&uart.serial, connections);
    return add_device(machine, &uart.serial.device, sizeof uart);
}
