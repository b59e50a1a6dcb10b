/* Sets of pending, enabled and active exceptions, and their priorities (DDI 0403E, B1.5.4 and B3.4). */
#include "state.h"

enum { PRIORITY_NMI = -2, PRIORITY_HARD_FAULT = -1 };
/* Bits in the first word of a set: exceptions that the NVIC cannot disable, and the first interrupts. */
#define SYSTEM_EXCEPTIONS 0xFFFEu
#define INTERRUPTS_OF_FIRST_WORD 0xFFFF0000u

/* -- sets --------------------------------------------------------------------------------------------------------- */

static bool holds(const uint32_t set[EXCEPTION_WORDS], int32_t exception)
{
    return (set[exception / 32] >> exception % 32 & 1) != 0;
}

static void include(uint32_t set[EXCEPTION_WORDS], int32_t exception) { set[exception / 32] |= 1u << exception % 32; }

static void exclude(uint32_t set[EXCEPTION_WORDS], int32_t exception)
{
    set[exception / 32] &= ~(1u << exception % 32);
}

/* Return the number of the lowest set bit of a word that is not zero. */
static int32_t lowest_bit(uint32_t word)
{
    int32_t number = 0;
    for (int32_t width = 16; width > 0; width /= 2)
        if ((word >> number & ((1u << width) - 1)) == 0)
            number += width;
    return number;
}

static bool exists(const struct core *core, int32_t exception)
{
    return exception > EXCEPTION_NONE && exception < EXCEPTIONS
        && (exception < FIRST_INTERRUPT || exception - FIRST_INTERRUPT < core->interrupts);
}

/* Return the exception of an external interrupt, or EXCEPTION_NONE if the part does not have it. */
static int32_t exception_of(const struct core *core, int32_t interrupt)
{
    bool is_number = interrupt >= 0 && interrupt < EXCEPTIONS - FIRST_INTERRUPT;
    return is_number && interrupt < core->interrupts ? FIRST_INTERRUPT + interrupt : EXCEPTION_NONE;
}

/* -- changes by software and peripherals -------------------------------------------------------------------------- */

void machine_pend(struct machine *machine, int32_t exception)
{
    struct core *core = &machine->core;
    if (!exists(core, exception))
        return;
    if (!holds(core->pending, exception))
        core->newly_pending = true;
    include(core->pending, exception);
    forget_answers(machine); /* registers of the NVIC have changed */
    machine->must_check = true;
}

/* An interrupt whose line is high stays pending, unless its handler runs: then it becomes pending at the return. */
void machine_unpend(struct machine *machine, int32_t exception)
{
    struct core *core = &machine->core;
    if (!exists(core, exception))
        return;
    bool is_held = holds(core->lines, exception) && !holds(core->is_active, exception);
    if (exception < FIRST_INTERRUPT || !is_held)
        exclude(core->pending, exception);
    forget_answers(machine);
}

void machine_set_line(struct machine *machine, int32_t interrupt, bool level)
{
    struct core *core = &machine->core;
    int32_t exception = exception_of(core, interrupt);
    if (exception == EXCEPTION_NONE || holds(core->lines, exception) == level)
        return;
    if (level) {
        include(core->lines, exception);
        machine_pend(machine, exception);
    } else {
        exclude(core->lines, exception);
    }
}

void machine_set_enabled(struct machine *machine, int32_t interrupt, bool enabled)
{
    struct core *core = &machine->core;
    int32_t exception = exception_of(core, interrupt);
    if (exception == EXCEPTION_NONE)
        return;
    if (enabled)
        include(core->enabled, exception);
    else
        exclude(core->enabled, exception);
    machine->must_check = true;
}

void machine_set_priority(struct machine *machine, int32_t exception, uint32_t value)
{
    struct core *core = &machine->core;
    if (!exists(core, exception) || exception < EXCEPTION_MEM_MANAGE)
        return;
    core->priority[exception] = (uint8_t)(value & core->priority_mask & 0xFF);
    machine->must_check = true;
}

/* -- priorities --------------------------------------------------------------------------------------------------- */

/* Priority among pending exceptions, sub-priority included; a lower number is more urgent. */
static int32_t order(const struct core *core, int32_t exception)
{
    if (exception == EXCEPTION_NMI)
        return PRIORITY_NMI;
    if (exception == EXCEPTION_HARD_FAULT)
        return PRIORITY_HARD_FAULT;
    return exception > EXCEPTION_NONE && exception < EXCEPTIONS ? core->priority[exception] : 0;
}

/* A priority byte without the bits that only order pending exceptions (B1.5.4, priority grouping). */
static int32_t group_of(const struct core *core, uint32_t priority)
{
    uint32_t mask = 0xFFu << ((core->priority_grouping & 7) + 1) & core->priority_mask & 0xFF;
    return (int32_t)(priority & mask);
}

int32_t machine_preemption_priority(struct machine *machine, int32_t exception)
{
    int32_t priority = order(&machine->core, exception);
    return priority < 0 ? priority : group_of(&machine->core, (uint32_t)priority);
}

/* ARMv6-M has neither FAULTMASK nor BASEPRI. */
int32_t machine_ceiling(struct machine *machine, bool without_primask)
{
    const struct core *core = &machine->core;
    if (!machine->baseline && (core->faultmask & 1) != 0)
        return PRIORITY_HARD_FAULT;
    if (!without_primask && (core->primask & 1) != 0)
        return 0;
    uint32_t basepri = machine->baseline ? 0 : core->basepri & core->priority_mask & 0xFF;
    return basepri != 0 ? group_of(core, basepri) : PRIORITY_IDLE;
}

int32_t machine_execution_priority(struct machine *machine, int32_t ceiling)
{
    int32_t urgent = ceiling;
    for (int32_t i = 0; i < active_exceptions(&machine->core); i++) {
        int32_t priority = machine_preemption_priority(machine, machine->core.active[i]);
        if (priority < urgent)
            urgent = priority;
    }
    return urgent;
}

static bool preempts(struct machine *machine, int32_t exception, int32_t ceiling)
{
    return machine_preemption_priority(machine, exception) < machine_execution_priority(machine, ceiling);
}

/* -- the most urgent exception ------------------------------------------------------------------------------------ */

/* Bits of a word of exceptions that are pending and enabled. */
static uint32_t ready_exceptions(const struct core *core, int32_t word)
{
    uint32_t enabled = core->enabled[word];
    if (word == 0)
        enabled = (enabled & INTERRUPTS_OF_FIRST_WORD) | SYSTEM_EXCEPTIONS;
    return core->pending[word] & enabled;
}

/* Of equal priorities the lower number comes first (B1.5.4). */
static int32_t first_ready(const struct core *core)
{
    int32_t first = EXCEPTION_NONE;
    for (int32_t word = 0; word < EXCEPTION_WORDS; word++)
        for (uint32_t ready = ready_exceptions(core, word); ready != 0; ready &= ready - 1) {
            int32_t exception = 32 * word + lowest_bit(ready);
            if (first == EXCEPTION_NONE || order(core, exception) < order(core, first))
                first = exception;
        }
    return first;
}

int32_t machine_most_urgent(struct machine *machine, int32_t ceiling)
{
    int32_t first = first_ready(&machine->core);
    return first != EXCEPTION_NONE && machine_preemption_priority(machine, first) < ceiling ? first : EXCEPTION_NONE;
}

int32_t machine_next_exception(struct machine *machine, int32_t ceiling)
{
    int32_t first = first_ready(&machine->core);
    return first != EXCEPTION_NONE && preempts(machine, first, ceiling) ? first : EXCEPTION_NONE;
}

/* -- entries and returns ------------------------------------------------------------------------------------------ */

int32_t active_exceptions(const struct core *core)
{
    int32_t count = core->active_count;
    return count < 0 ? 0 : count < ACTIVE_EXCEPTIONS ? count : ACTIVE_EXCEPTIONS;
}

int32_t last_active(const struct core *core)
{
    int32_t count = active_exceptions(core);
    return count == 0 ? EXCEPTION_NONE : core->active[count - 1];
}

void begin_exception(struct core *core, int32_t exception)
{
    int32_t count = active_exceptions(core);
    exclude(core->pending, exception);
    include(core->is_active, exception);
    include(core->taken, exception);
    if (count < ACTIVE_EXCEPTIONS) {
        core->active[count] = (uint16_t)exception;
        core->active_count = count + 1;
    }
}

void end_exception(struct core *core)
{
    int32_t exception = last_active(core);
    if (active_exceptions(core) == 0)
        return;
    core->active_count = active_exceptions(core) - 1;
    if (exception >= EXCEPTIONS)
        return;
    exclude(core->is_active, exception);
    if (exception >= FIRST_INTERRUPT && holds(core->lines, exception))
        include(core->pending, exception);
}

bool machine_can_ever_wake(struct machine *machine, int32_t ceiling)
{
    const struct core *core = &machine->core;
    if (preempts(machine, EXCEPTION_SYSTICK, ceiling))
        return true;
    for (int32_t word = 0; word < EXCEPTION_WORDS; word++)
        for (uint32_t bits = core->enabled[word] | core->pending[word]; bits; bits &= bits - 1)
            if (preempts(machine, 32 * word + lowest_bit(bits), ceiling))
                return true;
    return false;
}
