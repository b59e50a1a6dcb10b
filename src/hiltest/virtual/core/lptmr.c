/* LPTMR of Kinetis parts: a 16-bit timer on clocks that run while the processor is stopped, or a counter of pulses.
 *
 * Only power-on resets it. The counter of pulses has no glitch filter: PSR.PRESCALE does not
 * affect it. The end of a round that does not interrupt is no event: the flag is computed from the counts.
 */
#include "devices.h"

enum { CSR = 0x0, PSR = 0x4, CMR = 0x8, CNR = 0xC };
enum { CSR_TEN = 0x01, CSR_TMS = 0x02, CSR_TFC = 0x04, CSR_TPP = 0x08, CSR_TIE = 0x40, CSR_TCF = 0x80, CSR_BITS = 0x7F };
enum { PSR_PCS = 0x03, PSR_PBYP = 0x04, PSR_BITS = 0x7F, COUNTS = 1 << 16 };

struct lptmr {
    struct device device;
    struct machine_lptmr connections;
    int32_t inputs[2];    /* clocks that count the edges of pins */
    struct event compare; /* the count leaves the compare value, if that interrupts */
    uint32_t control, prescale;
    int32_t compare_value, latched; /* CMR; CNR: the count at the last write to it */
    int64_t began;        /* start of this round, in ticks of its source */
    int64_t due;          /* counts from the start after which the flag is set, unless it is set already */
    bool flag;
};

/* Return the clock that the timer counts; NO_CLOCK for the output of a comparator, which is not modelled. */
static int32_t source_of(const struct lptmr *lptmr)
{
    uint32_t pin = lptmr->control >> 4 & 3;
    if (lptmr->control & CSR_TMS)
        return pin == 1 || pin == 2 ? lptmr->inputs[pin - 1] : NO_CLOCK;
    return lptmr->connections.clocks[lptmr->prescale & PSR_PCS];
}

static bool is_counting(const struct lptmr *lptmr) { return lptmr->control & CSR_TEN && source_of(lptmr) != NO_CLOCK; }

/* Return the binary logarithm of the ticks per count. */
static uint32_t shift_of(const struct lptmr *lptmr)
{
    return lptmr->control & CSR_TMS || lptmr->prescale & PSR_PBYP ? 0 : (lptmr->prescale >> 3 & 0xF) + 1;
}

/* Counts since this round began. */
static int64_t counts_of(const struct machine *machine, const struct lptmr *lptmr)
{
    if (!is_counting(lptmr))
        return 0;
    return (ticks_now(machine, source_of(lptmr)) - lptmr->began) >> shift_of(lptmr);
}

static void begin_round(struct lptmr *lptmr, int64_t counts) { lptmr->began += counts << shift_of(lptmr); }

/* Count up to now. While the flag is set, ends of rounds are not recorded. */
static void advance(const struct machine *machine, struct lptmr *lptmr)
{
    bool is_free = lptmr->control & CSR_TFC;
    int64_t counts = counts_of(machine, lptmr), round = lptmr->compare_value + 1;
    if (!is_counting(lptmr))
        return;
    if (!lptmr->flag && counts >= lptmr->due) {
        lptmr->flag = true;
        if (!is_free)
            begin_round(lptmr, lptmr->due);
    }
    if (lptmr->flag && !is_free)
        begin_round(lptmr, counts_of(machine, lptmr) / round * round);
}

static int64_t due_tick(const struct lptmr *lptmr) { return lptmr->began + (lptmr->due << shift_of(lptmr)); }

/* Plan the event at which the count leaves the compare value, if that interrupts. */
static void plan(struct machine *machine, struct lptmr *lptmr)
{
    int64_t counts = counts_of(machine, lptmr);
    lptmr->due = counts + ((lptmr->compare_value - counts) & (COUNTS - 1)) + 1;
    cancel_event(machine, &lptmr->compare);
    if (is_counting(lptmr) && lptmr->control & CSR_TIE && !lptmr->flag)
        plan_event_at_tick(machine, &lptmr->compare, source_of(lptmr), due_tick(lptmr));
}

static void drive(struct machine *machine, const struct lptmr *lptmr)
{
    machine_set_line(machine, lptmr->connections.interrupt, lptmr->flag && lptmr->control & CSR_TIE);
}

static void leave_compare(struct machine *machine, struct event *event)
{
    struct lptmr *lptmr = OWNER(event, struct lptmr, compare);
    advance(machine, lptmr);
    drive(machine, lptmr);
}

/* A reset of the chip changes only the interrupt line. */
static void reset(struct machine *machine, struct device *device) { drive(machine, (struct lptmr *)device); }

static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    struct lptmr *lptmr = (struct lptmr *)device;
    switch (offset) {
    case CSR:
        advance(machine, lptmr);
        if (is_counting(lptmr) && !lptmr->flag)
            hold_answer(machine, clock_cycle(&machine->calendar.clocks[source_of(lptmr)], due_tick(lptmr)));
        return lptmr->control | (lptmr->flag ? CSR_TCF : 0);
    case PSR: return lptmr->prescale;
    case CMR: return (uint32_t)lptmr->compare_value;
    case CNR: return (uint32_t)lptmr->latched;
    default: return 0;
    }
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct lptmr *lptmr = (struct lptmr *)device;
    (void)size;
    advance(machine, lptmr);
    bool was_counting = is_counting(lptmr);
    int32_t source = source_of(lptmr);
    uint32_t shift = shift_of(lptmr);
    switch (offset) {
    case CSR:
        lptmr->control = value & CSR_BITS;
        lptmr->flag = lptmr->flag && !(value & CSR_TCF) && value & CSR_TEN;
        break;
    case PSR: lptmr->prescale = value & PSR_BITS; break;
    case CMR: lptmr->compare_value = value & 0xFFFF; break;
    case CNR: lptmr->latched = (int32_t)(counts_of(machine, lptmr) & (COUNTS - 1)); break;
    default: return;
    }
    bool counts_otherwise = !was_counting || source != source_of(lptmr) || shift != shift_of(lptmr);
    if (is_counting(lptmr) && counts_otherwise)
        lptmr->began = ticks_now(machine, source_of(lptmr));
    plan(machine, lptmr);
    drive(machine, lptmr);
}

bool machine_add_lptmr(struct machine *machine, uint32_t base, struct machine_lptmr connections)
{
    const int32_t first = machine_add_clock(machine), second = machine_add_clock(machine);
    const struct lptmr lptmr = {
        .device = {
            .base = base, .bytes = PAGE_BYTES, .read = read_by_words, .read_word = read_word, .write = write_register,
            .reset = reset},
        .compare.fire = leave_compare, .connections = connections, .inputs = {first, second}};
    return second != NO_CLOCK && add_device(machine, &lptmr.device, sizeof lptmr);
}

void machine_lptmr_edge(struct machine *machine, uint32_t base, int32_t pin, bool high)
{
    const struct lptmr *lptmr = (struct lptmr *)device_of(machine, base);
    if (high != (bool)(lptmr->control & CSR_TPP))
        tick_clock(machine, lptmr->inputs[pin - 1]);
}
