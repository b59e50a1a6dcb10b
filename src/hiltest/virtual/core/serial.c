/* The far end of a UART's wires, at the host: bytes on the line in both directions, and their times. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "devices.h"

enum { QUEUE_LIMIT = 1 << 24, SMALLEST_CAPACITY = 256 }; /* bytes of a queue */
static const double BAUD_TOLERANCE = 0.03; /* beyond this, the last bits are sampled during adjacent bits */
static const double PICOSECONDS = 1e12;

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

/* Cycles in which the thread executed: neither asleep nor in exceptions. */
static int64_t awake_cycles(const struct core *core)
{
    int64_t exceptions = core->exception_cycles
        + (core->exception == EXCEPTION_NONE ? 0 : core->cycles - core->exception_since);
    return core->cycles - core->idle_cycles - exceptions;
}

static void arrive(struct machine *machine, struct event *event)
{
    struct serial *serial = OWNER(event, struct serial, arrival);
    int64_t next = event->tick + serial->line_byte_ps;
    uint8_t byte = 0;
    if (queue_take(&serial->incoming, &byte, 1))
        serial->arrived(machine, serial, byte);
    serial->heard_at = machine->core.cycles;
    serial->heard_awake = awake_cycles(&machine->core);
    serial->is_unanswered = true;
    plan_event_at_tick(
        machine, serial->incoming.count ? &serial->arrival : &serial->idle, serial->connections.time, next);
}

static void be_idle(struct machine *machine, struct event *event)
{
    struct serial *serial = OWNER(event, struct serial, idle);
    if (!serial->arrival.is_planned)
        serial->fell_silent(machine, serial);
}

/* -- the board's side --------------------------------------------------------------------------------------------- */

/* Room for the byte at the host is reserved before it is on the line, so that no event needs memory. */
void expect_sent(struct machine *machine, struct serial *serial, int32_t count)
{
    if (serial->is_unanswered) {
        serial->answer.cycles = machine->core.cycles - serial->heard_at;
        serial->answer.awake_cycles = awake_cycles(&machine->core) - serial->heard_awake;
        serial->is_unanswered = false;
    }
    queue_reserve(&serial->sent, count);
}

void pass_to_host(struct machine *machine, struct serial *serial, uint8_t byte)
{
    if (is_garbled(machine, serial))
        byte ^= 0xFF;
    if (!queue_put(&serial->sent, byte))
        serial->has_lost = true;
    if (serial->sent.count >= serial->expected_count || byte == serial->expected_byte)
        notify_host(machine);
}

static double baud_of(const struct machine *machine, const struct serial *serial)
{
    const struct clock *clock = &machine->calendar.clocks[serial->connections.clock];
    const struct clock *time = &machine->calendar.clocks[serial->connections.time];
    double bit = serial->bit_ticks(serial);
    if (bit <= 0 || !time->numerator)
        return 0;
    double ticks = (double)clock->numerator * (double)time->denominator * PICOSECONDS;
    return ticks / ((double)clock->denominator * (double)time->numerator) / bit;
}

bool is_garbled(const struct machine *machine, const struct serial *serial)
{
    return fabs(baud_of(machine, serial) / serial->line_baud - 1) > BAUD_TOLERANCE;
}

/* -- the host ----------------------------------------------------------------------------------------------------- */

static void destroy(struct device *device)
{
    struct serial *serial = (struct serial *)device;
    free(serial->incoming.bytes);
    free(serial->sent.bytes);
}

/* Bytes between host and board are not part of the state: afterwards none is in transit. */
static void restore(struct device *device, const void *state)
{
    struct serial *serial = (struct serial *)device;
    const struct queue incoming = serial->incoming, sent = serial->sent;
    memcpy(serial, state, serial->device.size);
    serial->incoming = incoming;
    serial->sent = sent;
    serial->incoming.count = serial->sent.count = 0;
}

void begin_serial(struct serial *serial, struct machine_uart connections)
{
    serial->device.destroy = destroy;
    serial->device.restore = restore;
    serial->connections = connections;
    serial->expected_count = INT32_MAX;
    serial->expected_byte = -1;
    serial->arrival.fire = arrive;
    serial->idle.fire = be_idle;
}

static struct serial *serial_of(const struct machine *machine, uint32_t base)
{
    return (struct serial *)device_of(machine, base);
}

void machine_set_line_baud(struct machine *machine, uint32_t base, double baud, int64_t byte_ps)
{
    struct serial *serial = serial_of(machine, base);
    serial->line_baud = baud;
    serial->line_byte_ps = byte_ps;
}

double machine_uart_baud(struct machine *machine, uint32_t base) { return baud_of(machine, serial_of(machine, base)); }

bool machine_uart_write(struct machine *machine, uint32_t base, const uint8_t *bytes, int32_t count)
{
    struct serial *serial = serial_of(machine, base);
    if (!queue_reserve(&serial->incoming, count))
        return false;
    for (int32_t i = 0; i < count; i++)
        queue_put(&serial->incoming, bytes[i]);
    int32_t time = serial->connections.time;
    if (serial->incoming.count && !serial->arrival.is_planned)
        plan_event_at_tick(machine, &serial->arrival, time, ticks_now(machine, time) + serial->line_byte_ps);
    return true;
}

void machine_uart_expect(struct machine *machine, uint32_t base, int32_t count, int32_t byte)
{
    struct serial *serial = serial_of(machine, base);
    serial->expected_count = count;
    serial->expected_byte = byte;
}

int32_t machine_uart_arriving(struct machine *machine, uint32_t base) { return serial_of(machine, base)->incoming.count; }

int32_t machine_uart_waiting(struct machine *machine, uint32_t base) { return serial_of(machine, base)->sent.count; }

struct machine_answer machine_uart_answer(struct machine *machine, uint32_t base)
{
    return serial_of(machine, base)->answer;
}

int32_t machine_uart_read(struct machine *machine, uint32_t base, uint8_t *bytes, int32_t count)
{
    struct serial *serial = serial_of(machine, base);
    return serial->has_lost ? -1 : queue_take(&serial->sent, bytes, count);
}
