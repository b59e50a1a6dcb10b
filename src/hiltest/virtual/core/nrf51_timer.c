/* TIMER of nRF51 parts: a counter of a prescaled clock, or of tasks, with four compare registers.
 *
 * Writes of 1 to the first registers start tasks, and events are registers that interrupt while INTEN has their bits. The
 * host connects events and tasks of other blocks.
 */
#include "devices.h"

enum { START = 0x00, STOP = 0x04, COUNT = 0x08, CLEAR = 0x0C, SHUTDOWN = 0x10, CAPTURE = 0x40, TASKS_END = 0x100 };
enum { COMPARE = 0x140, SHORTS = 0x200, INTEN = 0x300, INTENSET = 0x304, INTENCLR = 0x308 };
enum { MODE = 0x504, BITMODE = 0x508, PRESCALER = 0x510, CC = 0x540, POWER = 0xFFC };
enum { CHANNELS = 4, SHORTS_STOP = 8, FIRST_INTERRUPT_BIT = 16, MOST_PRESCALER = 9, PRESCALER_AFTER_RESET = 4 };

struct timer {
    struct device device;
    struct machine_nrf51_timer connections;
    struct event compare; /* the next one, while it runs */
    bool is_running;
    uint32_t count;       /* at the tick `since` */
    int64_t since;
    uint32_t events;      /* bit n: EVENTS_COMPARE[n] */
    uint32_t enabled;     /* the same of INTEN */
    uint32_t shorts, mode, width, prescaler;
    uint32_t values[CHANNELS];
};

static uint32_t mask_of(const struct timer *timer)
{
    static const uint32_t MASKS[] = {0xFFFF, 0xFF, 0xFFFFFF, 0xFFFFFFFF}; /* by BITMODE */
    return MASKS[timer->width & 3];
}

static uint32_t shift_of(const struct timer *timer)
{
    return timer->prescaler < MOST_PRESCALER ? timer->prescaler : MOST_PRESCALER;
}

static bool counts_clock(const struct timer *timer) { return timer->is_running && !(timer->mode & 1); }

/* Return the count at a tick of the clock. */
static uint32_t count_at(const struct timer *timer, int64_t tick)
{
    uint32_t counts = counts_clock(timer) ? (uint32_t)((tick - timer->since) >> shift_of(timer)) : 0;
    return (timer->count + counts) & mask_of(timer);
}

/* Plan the next count after a tick that equals a compare register. */
static void plan(struct machine *machine, struct timer *timer, int64_t tick)
{
    cancel_event(machine, &timer->compare);
    if (!counts_clock(timer))
        return;
    int64_t counts = (tick - timer->since) >> shift_of(timer);
    uint32_t count = count_at(timer, tick), nearest = UINT32_MAX;
    for (int32_t n = 0; n < CHANNELS; n++) {
        uint32_t left = (timer->values[n] - count - 1) & mask_of(timer);
        nearest = left < nearest ? left : nearest;
    }
    counts += (int64_t)nearest + 1;
    plan_event_at_tick(
        machine, &timer->compare, timer->connections.clock, timer->since + (counts << shift_of(timer)));
}

/* Begin to count from a value at a tick, with an empty prescaler. */
static void set_count(struct machine *machine, struct timer *timer, int64_t tick, uint32_t count, bool is_running)
{
    timer->count = count;
    timer->is_running = is_running;
    timer->since = tick;
    plan(machine, timer, tick);
}

static void drive(struct machine *machine, const struct timer *timer)
{
    machine_set_line(machine, timer->connections.interrupt, (timer->events & timer->enabled) != 0);
}

static void start_task(struct machine *machine, struct timer *timer, int64_t tick, uint32_t task);

/* Set the events of the compare registers that equal the count at a tick. */
static void set_events(struct machine *machine, struct timer *timer, int64_t tick)
{
    uint32_t count = count_at(timer, tick), equal = 0;
    for (uint32_t n = 0; n < CHANNELS; n++)
        equal |= ((timer->values[n] & mask_of(timer)) == count) << n;
    timer->events |= equal;
    drive(machine, timer);
    if (timer->shorts & equal)
        start_task(machine, timer, tick, CLEAR);
    if (timer->shorts >> SHORTS_STOP & equal)
        start_task(machine, timer, tick, STOP);
    for (uint32_t n = 0; n < CHANNELS; n++)
        if (timer->connections.routed && equal >> n & 1)
            timer->connections.routed(timer->connections.context, timer->device.base + COMPARE + 4 * n);
}

/* The core may have passed the tick of the event meanwhile. */
static void reach(struct machine *machine, struct event *event)
{
    struct timer *timer = OWNER(event, struct timer, compare);
    int64_t tick = event->tick;
    set_events(machine, timer, tick);
    if (!event->is_planned)
        plan(machine, timer, tick);
}

static void start_task(struct machine *machine, struct timer *timer, int64_t tick, uint32_t task)
{
    uint32_t count = count_at(timer, tick);
    switch (task) {
    case START:
        if (!timer->is_running)
            set_count(machine, timer, tick, count, true);
        break;
    case STOP: case SHUTDOWN: set_count(machine, timer, tick, count, false); break;
    case CLEAR: set_count(machine, timer, tick, 0, timer->is_running); break;
    case COUNT:
        if (timer->is_running && timer->mode & 1) {
            timer->count = (count + 1) & mask_of(timer);
            set_events(machine, timer, tick);
        }
        break;
    default:
        if (task - CAPTURE < 4 * CHANNELS) {
            timer->values[(task - CAPTURE) / 4] = count;
            plan(machine, timer, tick);
        }
    }
}

static void reset(struct machine *machine, struct device *device)
{
    struct timer *timer = (struct timer *)device;
    timer->is_running = false;
    timer->count = timer->events = timer->enabled = timer->shorts = timer->mode = timer->width = 0;
    timer->prescaler = PRESCALER_AFTER_RESET;
    for (int32_t n = 0; n < CHANNELS; n++)
        timer->values[n] = 0;
    cancel_event(machine, &timer->compare);
    drive(machine, timer);
}

/* Change a setting of the running counter, which keeps its count. */
static void configure(struct machine *machine, struct timer *timer, int64_t tick, uint32_t *setting, uint32_t value)
{
    uint32_t count = count_at(timer, tick);
    *setting = value;
    set_count(machine, timer, tick, count & mask_of(timer), timer->is_running);
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct timer *timer = (struct timer *)device;
    int64_t tick = ticks_now(machine, timer->connections.clock);
    uint32_t bits = value >> FIRST_INTERRUPT_BIT & ((1 << CHANNELS) - 1);
    (void)size;
    if (offset < TASKS_END) {
        if (value & 1)
            start_task(machine, timer, tick, offset);
    } else if (offset - COMPARE < 4 * CHANNELS) {
        uint32_t bit = 1u << (offset - COMPARE) / 4;
        timer->events = value & 1 ? timer->events | bit : timer->events & ~bit;
    } else if (offset - CC < 4 * CHANNELS) {
        timer->values[(offset - CC) / 4] = value;
        plan(machine, timer, tick);
    }
    switch (offset) {
    case SHORTS: timer->shorts = value; break;
    case INTEN: timer->enabled = bits; break;
    case INTENSET: timer->enabled |= bits; break;
    case INTENCLR: timer->enabled &= ~bits; break;
    case MODE: configure(machine, timer, tick, &timer->mode, value & 1); break;
    case BITMODE: configure(machine, timer, tick, &timer->width, value & 3); break;
    case PRESCALER: configure(machine, timer, tick, &timer->prescaler, value & 0xF); break;
    case POWER:
        if (!(value & 1))
            reset(machine, device);
        break;
    default: break;
    }
    drive(machine, timer);
}

static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    struct timer *timer = (struct timer *)device;
    (void)machine;
    if (offset - COMPARE < 4 * CHANNELS)
        return timer->events >> (offset - COMPARE) / 4 & 1;
    if (offset - CC < 4 * CHANNELS)
        return timer->values[(offset - CC) / 4];
    switch (offset) {
    case SHORTS: return timer->shorts;
    case INTEN: case INTENSET: case INTENCLR: return timer->enabled << FIRST_INTERRUPT_BIT;
    case MODE: return timer->mode;
    case BITMODE: return timer->width;
    case PRESCALER: return timer->prescaler;
    case POWER: return 1;
    default: return 0;
    }
}

bool machine_add_nrf51_timer(struct machine *machine, uint32_t base, struct machine_nrf51_timer connections)
{
    const struct timer timer = {
        .device = {
            .base = base, .bytes = PAGE_BYTES, .read = read_by_words, .read_word = read_word, .write = write_register,
            .reset = reset},
        .compare.fire = reach, .connections = connections};
    return add_device(machine, &timer.device, sizeof timer);
}

void machine_route_nrf51_timer(struct machine *machine, uint32_t base, bool is_routed)
{
    struct timer *timer = (struct timer *)device_of(machine, base);
    if (timer)
        timer->connections.routed = is_routed ? timer->connections.route : NULL;
}
