/* TIM2 to TIM5 and TIM9 to TIM11 of STM32F4 parts: counters with update and compare events. References are to RM0383.
 *
 * Down and centre-aligned counting, slave modes, captures, outputs and DMA requests have no model; writes that select
 * them are counted as accesses to a register that is not modelled.
 */
#include "devices.h"

enum { CR1 = 0x00, SMCR = 0x08, DIER = 0x0C, SR = 0x10, EGR = 0x14, CCER = 0x20, CNT = 0x24, PSC = 0x28, ARR = 0x2C };
enum { CCR1 = 0x34, WORDS = 21, BLOCK_BYTES = 0x400, CHANNELS = 4 };
enum { CEN = 1, UDIS = 2, URS = 4, OPM = 8, DIRECTIONS = 0x70, ARPE = 0x80, UIF = 1, FLAGS = 0x1F, DMA_REQUESTS = 0x5F00 };

struct timer {
    struct device device;
    struct machine_stm32_timer connections;
    struct event next; /* the next change of a flag or of a buffered register */
    uint32_t words[WORDS];
    uint32_t count;             /* at the tick `since` */
    int64_t since;
    uint32_t prescaler, reload; /* PSC and ARR; PSC, and with ARPE also ARR, from an update on */
};

static uint32_t *word_of(struct timer *timer, uint32_t offset) { return &timer->words[offset / 4]; }

static bool counts(const struct timer *timer) { return timer->words[CR1 / 4] & CEN && timer->reload; }

/* Return the counts since `since`. */
static int64_t passed_at(const struct timer *timer, int64_t tick)
{
    return counts(timer) ? (tick - timer->since) / ((int64_t)timer->prescaler + 1) : 0;
}

/* Return the counts from `count` to the next overflow; a count above ARR first runs to the largest number. */
static int64_t left_of(const struct timer *timer)
{
    uint32_t top = timer->count <= timer->reload ? timer->reload : timer->connections.mask;
    return (int64_t)top - timer->count + 1;
}

static uint32_t count_at(const struct timer *timer, int64_t tick)
{
    int64_t passed = passed_at(timer, tick), left = left_of(timer);
    return (uint32_t)(passed < left ? timer->count + passed : (passed - left) % ((int64_t)timer->reload + 1));
}

/* Keep the count of a tick, because a setting changes; the prescaler keeps its fraction of a count. */
static void hold(struct timer *timer, int64_t tick)
{
    int64_t passed = passed_at(timer, tick);
    timer->count = count_at(timer, tick);
    timer->since = counts(timer) ? timer->since + passed * ((int64_t)timer->prescaler + 1) : tick;
}

/* Return the counts from `count` to the value of a channel; INT64_MAX if it is never reached. */
static int64_t distance_to(const struct timer *timer, uint32_t channel)
{
    uint32_t value = timer->words[CCR1 / 4 + channel] & timer->connections.mask;
    if (value > timer->reload)
        return INT64_MAX;
    return value > timer->count ? (int64_t)value - timer->count : left_of(timer) + value;
}

/* An overflow without effect needs no event: `count_at` divides. */
static bool overflow_matters(const struct timer *timer)
{
    bool is_loaded = timer->prescaler == timer->words[PSC / 4] && timer->reload == timer->words[ARR / 4];
    return timer->words[CR1 / 4] & OPM || (!(timer->words[CR1 / 4] & UDIS) && (!(timer->words[SR / 4] & UIF) || !is_loaded));
}

static void plan(struct machine *machine, struct timer *timer)
{
    cancel_event(machine, &timer->next);
    if (!counts(timer))
        return;
    int64_t nearest = overflow_matters(timer) ? left_of(timer) : INT64_MAX;
    for (uint32_t channel = 0; channel < CHANNELS; channel++)
        if (!(timer->words[SR / 4] >> (channel + 1) & 1))
            nearest = earlier(nearest, distance_to(timer, channel));
    if (nearest < INT64_MAX)
        plan_event_at_tick(
            machine, &timer->next, timer->connections.clock, timer->since + nearest * ((int64_t)timer->prescaler + 1));
}

static void drive(struct machine *machine, const struct timer *timer)
{
    machine_set_line(
        machine, timer->connections.interrupt, (timer->words[SR / 4] & timer->words[DIER / 4] & FLAGS) != 0);
}

static void load_settings(struct timer *timer)
{
    timer->prescaler = *word_of(timer, PSC);
    timer->reload = *word_of(timer, ARR);
}

/* Set the flags of the count that is reached; the core may have passed its tick meanwhile. */
static void reach(struct machine *machine, struct event *event)
{
    struct timer *timer = OWNER(event, struct timer, next);
    int64_t passed = passed_at(timer, event->tick);
    bool overflows = passed >= left_of(timer);
    uint32_t flags = 0;
    for (uint32_t channel = 0; channel < CHANNELS; channel++)
        flags |= (uint32_t)(distance_to(timer, channel) <= passed) << (channel + 1);
    hold(timer, event->tick);
    if (overflows && *word_of(timer, CR1) & OPM)
        *word_of(timer, CR1) &= ~(uint32_t)CEN;
    if (overflows && !(*word_of(timer, CR1) & UDIS)) {
        load_settings(timer);
        flags |= UIF;
    }
    *word_of(timer, SR) |= flags;
    plan(machine, timer);
    drive(machine, timer);
}

static void reset(struct machine *machine, struct device *device)
{
    struct timer *timer = (struct timer *)device;
    for (int32_t n = 0; n < WORDS; n++)
        timer->words[n] = 0;
    *word_of(timer, ARR) = timer->connections.mask;
    timer->count = 0;
    timer->since = 0;
    load_settings(timer);
    cancel_event(machine, &timer->next);
    drive(machine, timer);
}

static void generate(struct timer *timer, int64_t tick, uint32_t events)
{
    if (events & UIF && !(*word_of(timer, CR1) & UDIS)) {
        timer->count = 0;
        timer->since = tick;
        load_settings(timer);
        if (!(*word_of(timer, CR1) & URS))
            *word_of(timer, SR) |= UIF;
    }
    *word_of(timer, SR) |= events & (FLAGS - UIF);
}

/* Return whether a write selects a function without a model. */
static bool is_unmodelled(uint32_t offset, uint32_t value)
{
    if (offset == CR1)
        return value & DIRECTIONS;
    return offset == DIER ? (value & DMA_REQUESTS) != 0 : (offset == SMCR || offset == CCER) && value;
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct timer *timer = (struct timer *)device;
    const uint32_t place = offset & ~3u, shift = 8 * (offset & 3), mask = UINT32_MAX >> 8 * (4 - size) << shift;
    const int64_t tick = ticks_now(machine, timer->connections.clock);
    if (place / 4 >= WORDS)
        return;
    uint32_t *word = word_of(timer, place), after = (*word & ~mask) | (value << shift & mask);
    if (is_unmodelled(place, after))
        machine_note_access(
            machine, (struct machine_access){
                .address = device->base + offset, .size = size, .value = value, .is_write = true, .count = 1});
    hold(timer, tick);
    switch (place) {
    case SR: *word &= after | ~mask; break; /* a written one has no effect */
    case EGR: generate(timer, tick, after); break;
    case CNT:
        timer->count = after & timer->connections.mask;
        timer->since = tick;
        break;
    case PSC: *word = after & 0xFFFF; break;
    case ARR:
        *word = after & timer->connections.mask;
        timer->reload = *word_of(timer, CR1) & ARPE ? timer->reload : *word;
        break;
    default: *word = after;
    }
    plan(machine, timer);
    drive(machine, timer);
}

static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    struct timer *timer = (struct timer *)device;
    if (offset == CNT)
        return count_at(timer, ticks_now(machine, timer->connections.clock));
    return offset / 4 < WORDS ? *word_of(timer, offset) : 0;
}

bool machine_add_stm32_timer(struct machine *machine, uint32_t base, struct machine_stm32_timer connections)
{
    const struct timer timer = {
        .device = {
            .base = base, .bytes = BLOCK_BYTES, .read = read_by_words, .read_word = read_word, .write = write_register,
            .reset = reset},
        .next.fire = reach, .connections = connections};
    return add_device(machine, &timer.device, sizeof timer);
}
