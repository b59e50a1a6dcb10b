/* PIT of Kinetis parts: four periodic timers on the bus clock, which can be chained.
 *
 * Expiries that nobody observes cause no events: they are counted when a register is read, and the next one
 * is planned only if it interrupts or passes a DMA request.
 */
#include "devices.h"

enum { MCR = 0x0, FIRST_CHANNEL = 0x100, CHANNEL_BYTES = 0x10, CHANNELS = 4 };
enum { LDVAL = 0x0, CVAL = 0x4, TCTRL = 0x8, TFLG = 0xC };
enum { MCR_FRZ = 1, MCR_MDIS = 2, MCR_AFTER_RESET = 6 };
enum { TCTRL_TEN = 1, TCTRL_TIE = 2, TCTRL_CHN = 4, TCTRL_BITS = 7 };

struct channel {
    uint32_t load;      /* LDVAL, which the next expiry loads */
    uint32_t reload;    /* initial value of this round */
    uint32_t control;
    bool flag;
    int64_t began;      /* beginning of this round, in ticks of its source */
    int64_t expiries;
    int64_t enabled_at; /* [ps] */
};

struct pit {
    struct device device;
    struct machine_pit connections;
    struct event expiry; /* next observed expiry */
    uint32_t control;    /* MCR */
    uint32_t triggering; /* set of channels whose expiries trigger DMA channels */
    int64_t held;        /* ticks that have reached the timers, while the module is disabled */
    int64_t lost;        /* ticks of the bus clock that have not reached them */
    struct channel channels[CHANNELS];
};

/* -- counting ----------------------------------------------------------------------------------------------------- */

static int64_t ticks_of(const struct machine *machine, const struct pit *pit)
{
    return pit->control & MCR_MDIS ? pit->held : ticks_now(machine, pit->connections.clock) - pit->lost;
}

static bool is_chained(const struct pit *pit, int32_t index)
{
    return index > 0 && pit->channels[index].control & TCTRL_CHN;
}

/* Return the ticks of a channel's source: the bus clock, or expiries of the previous channel. */
static int64_t counted(const struct pit *pit, int32_t index, int64_t ticks)
{
    return is_chained(pit, index) ? pit->channels[index - 1].expiries : ticks;
}

static uint32_t value_of(const struct machine *machine, const struct pit *pit, int32_t index)
{
    const struct channel *channel = &pit->channels[index];
    if (!(channel->control & TCTRL_TEN))
        return 0;
    return (uint32_t)(channel->reload - (counted(pit, index, ticks_of(machine, pit)) - channel->began));
}

/* Count the expiries of a channel; return whether there were any. */
static bool count_expiries(struct channel *channel, int64_t elapsed)
{
    if (!(channel->control & TCTRL_TEN) || elapsed <= channel->reload)
        return false;
    int64_t round = (int64_t)channel->load + 1, more = (elapsed - channel->reload - 1) / round;
    channel->began += (int64_t)channel->reload + 1 + more * round;
    channel->expiries += 1 + more;
    channel->reload = channel->load;
    channel->flag = true;
    return true;
}

/* Count up to now, from the first channel to `last`: each may count the expiries of the previous one. */
static void advance(struct machine *machine, struct pit *pit, int32_t last)
{
    int64_t ticks = ticks_of(machine, pit);
    for (int32_t index = 0; index <= last; index++) {
        struct channel *channel = &pit->channels[index];
        bool has_expired = count_expiries(channel, counted(pit, index, ticks) - channel->began);
        if (has_expired && pit->triggering >> index & 1)
            trigger_request(machine, index);
    }
}

/* -- the next expiry ---------------------------------------------------------------------------------------------- */

/* Sums and products of chained rounds, which saturate at NEVER. */
static int64_t sum(int64_t a, int64_t b) { return a > NEVER - b ? NEVER : a + b; }

static int64_t product(int64_t a, int64_t b) { return b && a > NEVER / b ? NEVER : a * b; }

/* Return the bus clocks between expiries of a channel. */
static int64_t period_of(const struct pit *pit, int32_t index)
{
    int64_t period = 1;
    while (is_chained(pit, index) && pit->channels[index].control & TCTRL_TEN)
        period = product(period, (int64_t)pit->channels[index--].load + 1);
    return pit->channels[index].control & TCTRL_TEN ? product(period, (int64_t)pit->channels[index].load + 1) : NEVER;
}

/* Return the bus clocks up to the next expiry of a channel. A chained channel waits for an expiry of the previous one,
 * and then for so many of its rounds as the value says. */
static int64_t until_expiry(const struct machine *machine, const struct pit *pit, int32_t index)
{
    int64_t clocks = 0;
    for (; is_chained(pit, index) && pit->channels[index].control & TCTRL_TEN; index--) {
        int64_t rounds = value_of(machine, pit, index);
        clocks = sum(clocks, rounds ? product(rounds, period_of(pit, index - 1)) : 0);
    }
    if (!(pit->channels[index].control & TCTRL_TEN) || pit->control & MCR_MDIS)
        return NEVER;
    return sum(clocks, (int64_t)value_of(machine, pit, index) + 1);
}

/* Return the tick of the bus clock after a number of clocks from now; NEVER if it is too large. */
static int64_t tick_after(const struct machine *machine, const struct pit *pit, int64_t clocks)
{
    return sum(clocks, ticks_now(machine, pit->connections.clock));
}

/* Return the cycle at which a channel expires next. */
static int64_t expiry_cycle(const struct machine *machine, const struct pit *pit, int32_t index)
{
    int64_t tick = tick_after(machine, pit, until_expiry(machine, pit, index));
    return tick < NEVER ? clock_cycle(&machine->calendar.clocks[pit->connections.clock], tick) : NEVER;
}

/* Plan the next expiry of a channel that interrupts or triggers. */
static void plan(struct machine *machine, struct pit *pit)
{
    int64_t clocks = NEVER;
    for (int32_t index = 0; index < CHANNELS; index++) {
        bool is_seen = pit->channels[index].control & TCTRL_TIE || pit->triggering >> index & 1;
        clocks = is_seen ? earlier(clocks, until_expiry(machine, pit, index)) : clocks;
    }
    cancel_event(machine, &pit->expiry);
    int64_t tick = tick_after(machine, pit, clocks);
    if (tick < NEVER)
        plan_event_at_tick(machine, &pit->expiry, pit->connections.clock, tick);
}

static void drive(struct machine *machine, const struct pit *pit)
{
    for (int32_t index = 0; index < CHANNELS; index++) {
        const struct channel *channel = &pit->channels[index];
        machine_set_line(machine, pit->connections.interrupts[index], channel->control & TCTRL_TIE && channel->flag);
    }
}

static void expire(struct machine *machine, struct event *event)
{
    struct pit *pit = OWNER(event, struct pit, expiry);
    advance(machine, pit, CHANNELS - 1);
    drive(machine, pit);
    plan(machine, pit);
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static void reset(struct machine *machine, struct device *device)
{
    struct pit *pit = (struct pit *)device;
    cancel_event(machine, &pit->expiry);
    for (int32_t index = 0; index < CHANNELS; index++)
        pit->channels[index] = (struct channel){0};
    pit->control = MCR_AFTER_RESET;
    pit->held = pit->lost = 0;
}

static void enable_module(struct machine *machine, struct pit *pit, uint32_t value)
{
    int64_t ticks = ticks_of(machine, pit);
    pit->control = value & (MCR_MDIS | MCR_FRZ);
    pit->held = ticks;
    pit->lost = ticks_now(machine, pit->connections.clock) - ticks;
}

/* An enabled channel begins a round; a channel whose source changes keeps its remaining ticks. */
static void control_channel(struct machine *machine, struct pit *pit, int32_t index, uint32_t value)
{
    struct channel *channel = &pit->channels[index];
    int64_t ticks = ticks_of(machine, pit);
    int64_t elapsed = counted(pit, index, ticks) - channel->began;
    bool is_enabled = value & TCTRL_TEN && !(channel->control & TCTRL_TEN);
    channel->control = value;
    if (is_enabled) {
        channel->reload = channel->load;
        elapsed = 0;
        channel->enabled_at = ticks_now(machine, pit->connections.time);
    }
    channel->began = counted(pit, index, ticks) - elapsed;
}

static void write_channel(struct machine *machine, struct pit *pit, uint32_t offset, uint32_t value)
{
    int32_t index = (int32_t)(offset / CHANNEL_BYTES);
    struct channel *channel = &pit->channels[index];
    switch (offset % CHANNEL_BYTES) {
    case LDVAL: channel->load = value; break;
    case TCTRL: control_channel(machine, pit, index, value & TCTRL_BITS); break;
    case TFLG: channel->flag = channel->flag && !(value & 1); break;
    default: break;
    }
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct pit *pit = (struct pit *)device;
    (void)size;
    advance(machine, pit, CHANNELS - 1);
    if (offset == MCR)
        enable_module(machine, pit, value);
    else if (offset - FIRST_CHANNEL < CHANNELS * CHANNEL_BYTES)
        write_channel(machine, pit, offset - FIRST_CHANNEL, value);
    plan(machine, pit);
    drive(machine, pit);
}

static uint32_t read_channel(struct machine *machine, struct pit *pit, uint32_t offset)
{
    int32_t index = (int32_t)(offset / CHANNEL_BYTES);
    const struct channel *channel = &pit->channels[index];
    advance(machine, pit, index);
    switch (offset % CHANNEL_BYTES) {
    case LDVAL: return channel->load;
    case CVAL: return value_of(machine, pit, index);
    case TCTRL: return channel->control;
    case TFLG:
        if (!channel->flag)
            hold_answer(machine, expiry_cycle(machine, pit, index));
        return channel->flag;
    default: return 0;
    }
}

static uint32_t read_register(struct machine *machine, struct device *device, uint32_t offset, uint32_t size)
{
    struct pit *pit = (struct pit *)device;
    if (offset == MCR)
        return part_of_word(pit->control, 0, size);
    if (offset - FIRST_CHANNEL >= CHANNELS * CHANNEL_BYTES)
        return 0;
    return part_of_word(read_channel(machine, pit, offset - FIRST_CHANNEL), 0, size);
}

bool machine_add_pit(struct machine *machine, uint32_t base, struct machine_pit connections)
{
    const struct pit pit = {
        .device = {.base = base, .bytes = PAGE_BYTES, .read = read_register, .write = write_register, .reset = reset},
        .expiry.fire = expire, .connections = connections};
    return add_device(machine, &pit.device, sizeof pit);
}

void select_triggers(struct machine *machine, uint32_t base, uint32_t channels)
{
    struct pit *pit = (struct pit *)device_of(machine, base);
    if (!pit || channels == pit->triggering)
        return;
    advance(machine, pit, CHANNELS - 1);
    pit->triggering = channels;
    plan(machine, pit);
    drive(machine, pit);
}

int64_t machine_timer_enabled_at(struct machine *machine, uint32_t base, int32_t channel)
{
    const struct pit *pit = (const struct pit *)device_of(machine, base);
    return pit && channel >= 0 && channel < CHANNELS ? pit->channels[channel].enabled_at : 0;
}
