/* FTM of Kinetis parts: 16-bit counters whose channels compare, capture and generate pulse widths (K64 reference
 * manual, chapter "FlexTimer Module").
 *
 * Unobserved edges cause no events: flags, levels and loaded values are computed from the elapsed ticks. The next edge
 * is planned only if it interrupts or its channel is listened to.
 *
 * DMA requests, quadrature, faults, dead time, dual capture, hardware triggers, inversion and a common time base are
 * not modelled, and are reported if firmware requests them. Capture has no filter and no delay.
 */
#include "devices.h"

enum { SC = 0x00, CNT = 0x04, MOD = 0x08, FIRST_CHANNEL = 0x0C, CHANNEL_BYTES = 8, CNTIN = 0x4C, STATUS = 0x50 };
enum { MODE = 0x54, SYNC = 0x58, OUTINIT = 0x5C, OUTMASK = 0x60, COMBINE = 0x64, POL = 0x70, CONF = 0x84 };
enum { SYNCONF = 0x8C, SWOCTRL = 0x94, PWMLOAD = 0x98, REGISTER_BYTES = 0x9C, CHANNELS = 8, WORD_BYTES = 4 };
enum { SC_TOF = 0x80, SC_TOIE = 0x40, SC_CPWMS = 0x20, SC_COUNTING = 0x3F };
enum { CH_CHF = 0x80, CH_CHIE = 0x40, CH_MSB = 0x20, CH_MSA = 0x10, CH_ELSB = 0x08, CH_ELSA = 0x04, CH_ICRST = 0x02 };
enum { CH_DMA = 0x01, CH_EDGES = CH_ELSB | CH_ELSA };
enum { MODE_FTMEN = 1, MODE_INIT = 2, MODE_AFTER_RESET = 4 };
enum { SYNC_POINTS = 3, SYNC_REINIT = 4, SYNC_SWSYNC = 0x80 };
enum { SYNCONF_CNTINC = 4, SYNCONF_SYNCMODE = 0x80, SYNCONF_SWRSTCNT = 0x100, SYNCONF_SWWRBUF = 0x200 };
enum { PAIR_COMBINED = 1, PAIR_COMPLEMENTED = 2, PAIR_SYNCEN = 0x20, PWMLOAD_LDOK = 0x200 };
enum { NO_LEVEL = -1, NOTHING_BUFFERED = -1 };

enum kind { NOTHING, CAPTURE, COMPARE, PULSE_WIDTH };

struct channel {
    uint32_t control;    /* CnSC without its flag */
    uint32_t value;      /* CnV in effect */
    int32_t buffered;    /* written CnV that is not loaded yet, or NOTHING_BUFFERED */
    bool flag, flag_seen; /* CHF, and true if it was read after it was set: writing zero then clears it */
    bool high;           /* output before polarity; for a pulse width only while the counter is stopped */
    int32_t shown;       /* last reported level */
};

/* Phases are prescaled ticks since the counter was at its initial value, counting up. */
struct counter {
    uint32_t initial, modulo; /* CNTIN and MOD */
    bool up_down;
    int64_t began;       /* prescaled tick at the beginning of this round */
};

struct ftm {
    struct device device;
    struct machine_ftm connections;
    int32_t external;    /* clock that counts the rising edges of a pin */
    struct event edge;   /* next observed edge */
    uint32_t reported;   /* set of channels whose edges are reported */
    struct counter counter;
    int64_t phase;       /* while the counter is stopped */
    int64_t origin;      /* tick of the source from which prescaled ticks count */
    int64_t counted_to;  /* prescaled tick up to which the state is computed */
    int64_t overflows;
    bool flag, flag_seen; /* TOF */
    int32_t modulo, initial; /* written MOD and CNTIN that are not loaded yet, or NOTHING_BUFFERED */
    struct channel channels[CHANNELS];
    uint32_t registers[REGISTER_BYTES / WORD_BYTES];
};

static uint32_t word(const struct ftm *ftm, uint32_t offset) { return ftm->registers[offset / WORD_BYTES]; }

/* -- the counter -------------------------------------------------------------------------------------------------- */

/* Return the non-negative remainder of a division. */
static int64_t rest(int64_t dividend, int64_t divisor) { return (dividend % divisor + divisor) % divisor; }

/* Return the steps from the initial value to a value, and to the last one. */
static int64_t height_of(const struct counter *counter, uint32_t value) { return (value - counter->initial) & 0xFFFF; }

static int64_t top_of(const struct counter *counter)
{
    return height_of(counter, counter->modulo || counter->initial ? counter->modulo : 0xFFFF);
}

/* Ticks of a round. */
static int64_t period_of(const struct counter *counter)
{
    int64_t top = top_of(counter);
    return !counter->up_down ? top + 1 : top ? 2 * top : 1;
}

/* Return the phase at which TOF is set and buffered values are loaded: after MOD. */
static int64_t overflow_phase(const struct counter *counter) { return (top_of(counter) + 1) % period_of(counter); }

static int64_t height_at(const struct counter *counter, int64_t phase)
{
    int64_t top = top_of(counter);
    return phase <= top ? phase : 2 * top - phase;
}

/* Return the first tick after another at which the counter is at a phase. */
static int64_t next_tick(const struct counter *counter, int64_t phase, int64_t after)
{
    return after + rest(phase - (after - counter->began) - 1, period_of(counter)) + 1;
}

/* Return how often the counter is at a phase after one tick and up to another. */
static int64_t times_between(const struct counter *counter, int64_t phase, int64_t after, int64_t until)
{
    int64_t first = next_tick(counter, phase, after);
    return first > until ? 0 : 1 + (until - first) / period_of(counter);
}

/* Find the phases with a value: none, one, or one in each direction. */
static int32_t find_matches(const struct counter *counter, uint32_t value, int64_t phases[2])
{
    int64_t height = height_of(counter, value), period = period_of(counter);
    if (height > top_of(counter))
        return 0;
    phases[0] = height;
    phases[1] = period - height;
    return counter->up_down && height < phases[1] && phases[1] < period ? 2 : 1;
}

static int32_t source_of(const struct ftm *ftm)
{
    const int32_t sources[] = {NO_CLOCK, ftm->connections.bus_clock, ftm->connections.fixed_clock, ftm->external};
    return sources[word(ftm, SC) >> 3 & 3];
}

static bool is_counting(const struct ftm *ftm) { return source_of(ftm) != NO_CLOCK; }

static int64_t phase_of(const struct ftm *ftm)
{
    const struct counter *counter = &ftm->counter;
    return is_counting(ftm) ? rest(ftm->counted_to - counter->began, period_of(counter)) : ftm->phase;
}

/* Continue counting from a phase. */
static void restart(struct machine *machine, struct ftm *ftm, int64_t phase)
{
    ftm->phase = phase;
    if (!is_counting(ftm))
        return;
    ftm->origin = ticks_now(machine, source_of(ftm));
    ftm->counted_to = 0;
    ftm->counter.began = -phase;
}

/* -- buffered values ---------------------------------------------------------------------------------------------- */

/* The bits of COMBINE of the pair that a channel belongs to. */
static uint32_t pair_of(const struct ftm *ftm, int32_t index) { return word(ftm, COMBINE) >> 8 * (index / 2); }

/* Return whether the end of a round loads all values. */
static bool loads_at_once(const struct ftm *ftm)
{
    return !(word(ftm, MODE) & MODE_FTMEN) || word(ftm, PWMLOAD) & PWMLOAD_LDOK;
}

/* Return whether the end of a round is the loading point of a software trigger. */
static bool synchronises(const struct ftm *ftm)
{
    return word(ftm, SYNC) & SYNC_SWSYNC && word(ftm, SYNC) & SYNC_POINTS;
}

/* Return whether the end of this round loads any value. */
static bool will_load(const struct ftm *ftm)
{
    bool has_buffered = ftm->modulo >= 0 || ftm->initial >= 0;
    for (int32_t index = 0; index < CHANNELS; index++)
        has_buffered |= ftm->channels[index].buffered >= 0;
    return has_buffered && (loads_at_once(ftm) || synchronises(ftm));
}

static void take_over(uint32_t *value, int32_t *buffered)
{
    if (*buffered >= 0)
        *value = (uint32_t)*buffered;
    *buffered = NOTHING_BUFFERED;
}

static void take_over_all(struct ftm *ftm)
{
    take_over(&ftm->counter.modulo, &ftm->modulo);
    take_over(&ftm->counter.initial, &ftm->initial);
    for (int32_t index = 0; index < CHANNELS; index++)
        take_over(&ftm->channels[index].value, &ftm->channels[index].buffered);
}

/* Load the values that a software trigger selects, and end the trigger. */
static void synchronise(struct ftm *ftm)
{
    uint32_t options = word(ftm, SYNCONF);
    ftm->registers[SYNC / WORD_BYTES] &= ~(uint32_t)SYNC_SWSYNC;
    if (options & SYNCONF_SYNCMODE && !(options & SYNCONF_SWWRBUF))
        return;
    take_over(&ftm->counter.modulo, &ftm->modulo);
    if (options & SYNCONF_CNTINC)
        take_over(&ftm->counter.initial, &ftm->initial);
    for (int32_t index = 0; index < CHANNELS; index++)
        if (pair_of(ftm, index) & PAIR_SYNCEN)
            take_over(&ftm->channels[index].value, &ftm->channels[index].buffered);
}

/* Begin a synchronisation by software: at once with a restart of the counter, or at a loading point. */
static void trigger(struct machine *machine, struct ftm *ftm)
{
    uint32_t options = word(ftm, SYNCONF);
    if (options & SYNCONF_SYNCMODE ? options & SYNCONF_SWRSTCNT : word(ftm, SYNC) & SYNC_REINIT) {
        synchronise(ftm);
        restart(machine, ftm, 0);
    }
}

/* -- channels ----------------------------------------------------------------------------------------------------- */

static enum kind kind_of(const struct ftm *ftm, int32_t index)
{
    uint32_t control = ftm->channels[index].control;
    if (index >= ftm->connections.channels)
        return NOTHING;
    if (word(ftm, SC) & SC_CPWMS || pair_of(ftm, index) & PAIR_COMBINED || control & CH_MSB)
        return PULSE_WIDTH;
    if (control & CH_MSA)
        return COMPARE;
    return control & CH_EDGES ? CAPTURE : NOTHING;
}

/* Return whether a pulse width is in its active part. */
static bool is_active(const struct ftm *ftm, int32_t index)
{
    const struct counter *counter = &ftm->counter;
    int64_t phase = phase_of(ftm), height = height_of(counter, ftm->channels[index].value);
    if (pair_of(ftm, index) & PAIR_COMBINED)
        return height_of(counter, ftm->channels[index & ~1].value) <= phase
            && phase < height_of(counter, ftm->channels[index | 1].value);
    return phase < height || (counter->up_down && phase >= period_of(counter) - height);
}

/* The output of a channel, before polarity. */
static bool is_high(const struct ftm *ftm, int32_t index)
{
    uint32_t pair = pair_of(ftm, index);
    int32_t leader = pair & (PAIR_COMBINED | PAIR_COMPLEMENTED) ? index & ~1 : index;
    bool is_inverted = ftm->channels[leader].control & CH_ELSA;
    if (kind_of(ftm, index) != PULSE_WIDTH || !is_counting(ftm))
        return ftm->channels[index].high;
    return is_active(ftm, leader) != (is_inverted != (leader != index && pair & PAIR_COMPLEMENTED));
}

static int32_t level_of(const struct ftm *ftm, int32_t index)
{
    bool polarity = word(ftm, POL) >> index & 1;
    uint32_t forced = word(ftm, SWOCTRL) >> index;
    if (kind_of(ftm, index) < COMPARE || !(ftm->channels[index].control & CH_EDGES))
        return NO_LEVEL;
    if (word(ftm, OUTMASK) >> index & 1)
        return polarity;
    return (forced & 1 ? forced >> 8 & 1 : is_high(ftm, index)) != polarity;
}

static void raise_flag(struct channel *channel)
{
    channel->flag = true;
    channel->flag_seen = false;
}

/* Count so many matches of a channel's value. */
static void match(struct channel *channel, enum kind kind, int64_t times)
{
    uint32_t action = channel->control & CH_EDGES;
    if (kind >= COMPARE)
        raise_flag(channel);
    if (kind == COMPARE && action == CH_ELSA)
        channel->high ^= times & 1;
    else if (kind == COMPARE && action)
        channel->high = action == CH_EDGES;
}

/* -- counting ----------------------------------------------------------------------------------------------------- */

/* Return the number of overflows that will not set TOF before the next one that does: NUMTOF. */
static int64_t silent_overflows(const struct ftm *ftm) { return rest(-ftm->overflows, (word(ftm, CONF) & 0x1F) + 1); }

static void count_overflows(struct ftm *ftm, int64_t times)
{
    if (times > silent_overflows(ftm)) {
        ftm->flag = true;
        ftm->flag_seen = false;
    }
    ftm->overflows += times;
}

/* Load values at the end of a round. A counter on its way down continues down from the new top. */
static void end_round(struct ftm *ftm, bool loads)
{
    struct counter *counter = &ftm->counter;
    int64_t height = height_at(counter, ftm->counted_to - counter->began);
    if (loads_at_once(ftm))
        take_over_all(ftm);
    else if (synchronises(ftm))
        synchronise(ftm);
    if (loads && counter->up_down)
        counter->began = ftm->counted_to - rest(2 * top_of(counter) - height, period_of(counter));
}

/* Count up to a tick, before which no value is loaded. */
static void count_to(struct ftm *ftm, int64_t until, bool loads)
{
    struct counter *counter = &ftm->counter;
    for (int32_t index = 0; index < ftm->connections.channels; index++) {
        int64_t phases[2], times = 0;
        for (int32_t matches = find_matches(counter, ftm->channels[index].value, phases); matches > 0; matches--)
            times += times_between(counter, phases[matches - 1], ftm->counted_to, until);
        if (times)
            match(&ftm->channels[index], kind_of(ftm, index), times);
    }
    int64_t overflows = times_between(counter, overflow_phase(counter), ftm->counted_to, until);
    counter->began += (until - counter->began) / period_of(counter) * period_of(counter);
    ftm->counted_to = until;
    if (overflows) {
        count_overflows(ftm, overflows);
        end_round(ftm, loads);
    }
}

static int64_t next_overflow(const struct ftm *ftm)
{
    return next_tick(&ftm->counter, overflow_phase(&ftm->counter), ftm->counted_to);
}

/* Count up to now, in two steps if the end of a round loads values. */
static void advance(struct machine *machine, struct ftm *ftm)
{
    if (!is_counting(ftm))
        return;
    int64_t now = (ticks_now(machine, source_of(ftm)) - ftm->origin) >> (word(ftm, SC) & 7);
    while (ftm->counted_to < now) {
        bool loads = will_load(ftm);
        count_to(ftm, loads ? earlier(now, next_overflow(ftm)) : now, loads);
    }
}

/* -- the next edge ------------------------------------------------------------------------------------------------ */

/* Return the next tick at which the counter is at the value of one of some channels. */
static int64_t next_match(const struct ftm *ftm, uint32_t channels)
{
    int64_t tick = NEVER, phases[2];
    for (int32_t index = 0; index < ftm->connections.channels; index++) {
        int32_t matches = channels >> index & 1 ? find_matches(&ftm->counter, ftm->channels[index].value, phases) : 0;
        for (; matches > 0; matches--)
            tick = earlier(tick, next_tick(&ftm->counter, phases[matches - 1], ftm->counted_to));
    }
    return tick;
}

/* Return the next tick of an observable change. */
static int64_t next_edge(const struct ftm *ftm)
{
    uint32_t awaited = 0, followed = 0;
    for (int32_t index = 0; index < ftm->connections.channels; index++) {
        const struct channel *channel = &ftm->channels[index];
        uint32_t both = pair_of(ftm, index) & (PAIR_COMBINED | PAIR_COMPLEMENTED) ? 3u << (index & ~1) : 0;
        if (kind_of(ftm, index) >= COMPARE && channel->control & CH_CHIE && !channel->flag)
            awaited |= 1u << index;
        if (ftm->reported >> index & 1 && level_of(ftm, index) != NO_LEVEL)
            followed |= 1u << index | both;
    }
    bool waits = word(ftm, SC) & SC_TOIE && !ftm->flag;
    int64_t tick = next_match(ftm, awaited | followed), overflow = next_overflow(ftm);
    if (followed || (will_load(ftm) && (awaited || waits)))
        return earlier(tick, overflow);
    return waits ? earlier(tick, overflow + silent_overflows(ftm) * period_of(&ftm->counter)) : tick;
}

static int64_t source_tick(const struct ftm *ftm, int64_t tick) { return ftm->origin + (tick << (word(ftm, SC) & 7)); }

/* Let an answer hold until a flag or a level may change. */
static void hold_level(struct machine *machine, const struct ftm *ftm)
{
    if (!is_counting(ftm))
        return;
    int64_t tick = source_tick(ftm, earlier(next_match(ftm, UINT32_MAX), next_overflow(ftm)));
    hold_answer(machine, clock_cycle(&machine->calendar.clocks[source_of(ftm)], tick));
}

static void plan(struct machine *machine, struct ftm *ftm)
{
    int64_t tick = is_counting(ftm) ? next_edge(ftm) : NEVER;
    cancel_event(machine, &ftm->edge);
    if (tick < NEVER)
        plan_event_at_tick(machine, &ftm->edge, source_of(ftm), source_tick(ftm, tick));
}

static void drive(struct machine *machine, const struct ftm *ftm)
{
    bool level = ftm->flag && word(ftm, SC) & SC_TOIE;
    for (int32_t index = 0; index < CHANNELS; index++)
        level |= ftm->channels[index].flag && (ftm->channels[index].control & (CH_CHIE | CH_DMA)) == CH_CHIE;
    machine_set_line(machine, ftm->connections.interrupt, level);
}

/* Apply changes of flags and levels, and plan the next change. */
static void settle(struct machine *machine, struct ftm *ftm)
{
    uint32_t changed = 0;
    for (int32_t index = 0; index < ftm->connections.channels; index++) {
        int32_t level = ftm->reported >> index & 1 ? level_of(ftm, index) : NO_LEVEL;
        changed |= (uint32_t)(level != ftm->channels[index].shown) << index;
        ftm->channels[index].shown = level;
    }
    drive(machine, ftm);
    plan(machine, ftm);
    for (int32_t index = 0; index < ftm->connections.channels; index++)
        if (changed & ftm->reported & 1u << index)
            ftm->connections.changed(ftm->connections.context, index);
}

static void pass_edge(struct machine *machine, struct event *event)
{
    struct ftm *ftm = OWNER(event, struct ftm, edge);
    advance(machine, ftm);
    settle(machine, ftm);
}

/* -- registers ---------------------------------------------------------------------------------------------------- */

static void reset(struct machine *machine, struct device *device)
{
    struct ftm *ftm = (struct ftm *)device;
    for (int32_t index = 0; index < CHANNELS; index++)
        ftm->channels[index] = (struct channel){.buffered = NOTHING_BUFFERED, .shown = ftm->channels[index].shown};
    for (uint32_t i = 0; i < REGISTER_BYTES / WORD_BYTES; i++)
        ftm->registers[i] = 0;
    ftm->registers[MODE / WORD_BYTES] = MODE_AFTER_RESET;
    ftm->counter = (struct counter){0};
    ftm->phase = ftm->origin = ftm->counted_to = ftm->overflows = 0;
    ftm->modulo = ftm->initial = NOTHING_BUFFERED;
    ftm->flag = ftm->flag_seen = false;
    settle(machine, ftm);
}

static struct channel *channel_at(struct ftm *ftm, uint32_t offset)
{
    uint32_t index = (offset - FIRST_CHANNEL) / CHANNEL_BYTES;
    return offset >= FIRST_CHANNEL && index < (uint32_t)ftm->connections.channels ? &ftm->channels[index] : NULL;
}

/* Reading a flag is the first step of clearing it. */
static uint32_t read_channel(struct channel *channel, bool is_value)
{
    if (is_value)
        return channel->value;
    channel->flag_seen = channel->flag;
    return channel->control | (channel->flag ? CH_CHF : 0);
}

static uint32_t read_status(struct ftm *ftm)
{
    uint32_t status = 0;
    for (int32_t index = 0; index < CHANNELS; index++) {
        ftm->channels[index].flag_seen = ftm->channels[index].flag;
        status |= (uint32_t)ftm->channels[index].flag << index;
    }
    return status;
}

static uint32_t read_word(struct ftm *ftm, uint32_t offset)
{
    struct channel *channel = channel_at(ftm, offset);
    if (channel)
        return read_channel(channel, (offset - FIRST_CHANNEL) % CHANNEL_BYTES);
    switch (offset) {
    case SC:
        ftm->flag_seen = ftm->flag;
        return word(ftm, SC) | (ftm->flag ? SC_TOF : 0);
    case CNT: return (ftm->counter.initial + (uint32_t)height_at(&ftm->counter, phase_of(ftm))) & 0xFFFF;
    case MOD: return ftm->counter.modulo;
    case CNTIN: return ftm->counter.initial;
    case STATUS: return read_status(ftm);
    default: return offset < REGISTER_BYTES ? word(ftm, offset) : 0;
    }
}

static uint32_t read_register(struct machine *machine, struct device *device, uint32_t offset)
{
    struct ftm *ftm = (struct ftm *)device;
    advance(machine, ftm);
    hold_level(machine, ftm);
    return read_word(ftm, offset);
}

static void write_control(struct machine *machine, struct ftm *ftm, uint32_t value)
{
    int64_t phase = phase_of(ftm);
    bool counts_otherwise = (word(ftm, SC) ^ value) & SC_COUNTING;
    ftm->flag = ftm->flag && (value & SC_TOF || !ftm->flag_seen);
    ftm->registers[SC / WORD_BYTES] = value & (SC_TOIE | SC_COUNTING);
    ftm->counter.up_down = value & SC_CPWMS;
    if (counts_otherwise)
        restart(machine, ftm, phase % period_of(&ftm->counter));
    if (!is_counting(ftm))
        take_over_all(ftm);
}

static void write_limit(struct ftm *ftm, uint32_t offset, int32_t value)
{
    bool takes_modulo = !is_counting(ftm), takes_initial = takes_modulo || !(word(ftm, MODE) & MODE_FTMEN);
    *(offset == MOD ? &ftm->modulo : &ftm->initial) = value;
    if (takes_modulo)
        take_over(&ftm->counter.modulo, &ftm->modulo);
    if (takes_initial)
        take_over(&ftm->counter.initial, &ftm->initial);
    if (takes_modulo && offset == CNTIN)
        ftm->phase = 0;
}

static void write_status(struct ftm *ftm, uint32_t value)
{
    for (int32_t index = 0; index < CHANNELS; index++)
        ftm->channels[index].flag &= value >> index & 1 || !ftm->channels[index].flag_seen;
}

static void write_channel(struct ftm *ftm, int32_t index, bool is_value, uint32_t value)
{
    struct channel *channel = &ftm->channels[index];
    enum kind kind = kind_of(ftm, index);
    if (!is_value) {
        channel->flag = channel->flag && (value & CH_CHF || !channel->flag_seen);
        channel->control = value & 0x7F;
        return;
    }
    if (kind == CAPTURE)
        return; /* read-only */
    channel->buffered = value & 0xFFFF;
    bool is_synchronised = word(ftm, MODE) & MODE_FTMEN && pair_of(ftm, index) & PAIR_SYNCEN;
    if (!is_counting(ftm) || (kind != PULSE_WIDTH && !is_synchronised))
        take_over(&channel->value, &channel->buffered);
}

static void write_common(struct machine *machine, struct ftm *ftm, uint32_t offset, uint32_t value)
{
    ftm->registers[offset / WORD_BYTES] = value;
    if (offset == MODE && value & MODE_INIT) {
        ftm->registers[MODE / WORD_BYTES] &= ~(uint32_t)MODE_INIT;
        for (int32_t index = 0; index < CHANNELS; index++)
            ftm->channels[index].high = word(ftm, OUTINIT) >> index & 1;
    } else if (offset == SYNC && value & SYNC_SWSYNC) {
        trigger(machine, ftm);
    }
}

static void write_word(struct machine *machine, struct ftm *ftm, uint32_t offset, uint32_t value)
{
    const struct channel *channel = channel_at(ftm, offset);
    if (channel) {
        write_channel(ftm, (int32_t)(channel - ftm->channels), (offset - FIRST_CHANNEL) % CHANNEL_BYTES, value);
        return;
    }
    switch (offset) {
    case SC: write_control(machine, ftm, value); break;
    case CNT: restart(machine, ftm, 0); break;
    case MOD: case CNTIN: write_limit(ftm, offset, value & 0xFFFF); break;
    case STATUS: write_status(ftm, value); break;
    default:
        if (offset > CNTIN && offset < REGISTER_BYTES)
            write_common(machine, ftm, offset, value);
    }
}

/* Return the bits that request unmodelled functions. */
static uint32_t unmodelled_bits(struct ftm *ftm, uint32_t offset)
{
    if (channel_at(ftm, offset))
        return (offset - FIRST_CHANNEL) % CHANNEL_BYTES ? 0 : CH_DMA;
    switch (offset) {
    case MODE: return 0xE0;          /* interrupts and modes of faults */
    case SYNC: return 0x70;          /* hardware triggers */
    case COMBINE: return 0x5C5C5C5C; /* faults, dead time and dual capture of each pair */
    case 0x6C: return 0xFF;          /* EXTTRIG: triggers for other modules */
    case 0x7C: return 0x7F;          /* FLTCTRL: faults */
    case 0x80: return 0x1;           /* QDCTRL: quadrature */
    case CONF: return 0x600;         /* a common time base */
    case 0x90: return 0xF;           /* INVCTRL: inversion */
    default: return 0;
    }
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct ftm *ftm = (struct ftm *)device;
    advance(machine, ftm);
    for (int32_t index = 0; index < ftm->connections.channels; index++)
        ftm->channels[index].high = is_high(ftm, index); /* for the case that the counter stops */
    if (value & unmodelled_bits(ftm, offset))
        ftm->connections.note(ftm->connections.context, device->base + offset, size, value);
    if (offset % WORD_BYTES == 0)
        write_word(machine, ftm, offset, value);
    settle(machine, ftm);
}

/* -- pins --------------------------------------------------------------------------------------------------------- */

bool machine_add_ftm(struct machine *machine, uint32_t base, struct machine_ftm connections)
{
    const struct ftm ftm = {
        .device = {
            .base = base, .bytes = PAGE_BYTES, .read = read_by_words, .read_word = read_register,
            .write = write_register, .reset = reset},
        .edge.fire = pass_edge, .connections = connections, .external = machine_add_clock(machine)};
    return ftm.external != NO_CLOCK && add_device(machine, &ftm.device, sizeof ftm);
}

void machine_report_channels(struct machine *machine, uint32_t base, uint32_t channels)
{
    struct ftm *ftm = (struct ftm *)device_of(machine, base);
    advance(machine, ftm);
    ftm->reported = channels;
    for (int32_t index = 0; index < CHANNELS; index++)
        ftm->channels[index].shown = channels >> index & 1 ? level_of(ftm, index) : NO_LEVEL;
    plan(machine, ftm);
}

int32_t machine_channel_level(struct machine *machine, uint32_t base, int32_t channel)
{
    struct ftm *ftm = (struct ftm *)device_of(machine, base);
    advance(machine, ftm);
    hold_level(machine, ftm);
    return level_of(ftm, channel);
}

void machine_channel_edge(struct machine *machine, uint32_t base, int32_t index, bool high)
{
    struct ftm *ftm = (struct ftm *)device_of(machine, base);
    struct channel *channel = &ftm->channels[index];
    if (!is_counting(ftm) || kind_of(ftm, index) != CAPTURE || !(channel->control & (high ? CH_ELSA : CH_ELSB)))
        return;
    advance(machine, ftm);
    channel->value = read_word(ftm, CNT);
    raise_flag(channel);
    if (channel->control & CH_ICRST)
        restart(machine, ftm, 0);
    settle(machine, ftm);
}

void machine_ftm_clock_edge(struct machine *machine, uint32_t base)
{
    tick_clock(machine, ((struct ftm *)device_of(machine, base))->external);
}
