/* Entry and return of exceptions, with their costs: frames, EXC_RETURN, floating-point state, escalation of faults.
 *
 * References are to the ARMv7-M Architecture Reference Manual, DDI 0403E.
 */
#include <string.h>

#include "float.h"
#include "registers.h"
#include "stacks.h"

/* A frame: r0 to r3, r12, lr, the return address, xPSR; an extended one also has s0 to s15, FPSCR and an unused word
 * (B1.5.6 and B1.5.7). */
enum {
    FRAME_LR = 5, FRAME_PC = 6, FRAME_XPSR = 7, FRAME_WORDS = 8, FRAME_BYTES = 32, EXTENDED_FRAME_BYTES = 104,
    S_REGISTERS = 16, FLOATING_WORDS = 17, FLOATING_BYTES = 68,
};

#define EXC_RETURN 0xFFFFFFE1u /* bits that are always set (B1.5.8) */
enum { RETURN_PROCESS_STACK = 1 << 2, RETURN_THREAD = 1 << 3, RETURN_BASIC_FRAME = 1 << 4 };

/* -- faults ------------------------------------------------------------------------------------------------------- */

#define CFSR_BFARVALID (1u << 15)
#define HFSR_FORCED (1u << 30)

/* The exception of a kind of fault, and its bits in CFSR and HFSR (B1.5.14, B3.2.15, B3.2.16). */
struct fault_entry {
    int32_t exception;
    uint32_t cfsr, hfsr;
};

static const struct fault_entry FAULT_TABLE[] = {
    [FAULT_EXECUTE_NEVER] = {EXCEPTION_MEM_MANAGE, 1u << 0, 0},
    [FAULT_INSTRUCTION_BUS] = {EXCEPTION_BUS_FAULT, 1u << 8, 0},
    [FAULT_DATA_BUS] = {EXCEPTION_BUS_FAULT, 1u << 9, 0},
    [FAULT_UNSTACKING] = {EXCEPTION_BUS_FAULT, 1u << 11, 0},
    [FAULT_STACKING] = {EXCEPTION_BUS_FAULT, 1u << 12, 0},
    [FAULT_UNDEFINED_INSTRUCTION] = {EXCEPTION_USAGE_FAULT, 1u << 16, 0},
    [FAULT_INVALID_STATE] = {EXCEPTION_USAGE_FAULT, 1u << 17, 0},
    [FAULT_INVALID_RETURN] = {EXCEPTION_USAGE_FAULT, 1u << 18, 0},
    [FAULT_NO_COPROCESSOR] = {EXCEPTION_USAGE_FAULT, 1u << 19, 0},
    [FAULT_UNALIGNED] = {EXCEPTION_USAGE_FAULT, 1u << 24, 0},
    [FAULT_DIVIDE_BY_ZERO] = {EXCEPTION_USAGE_FAULT, 1u << 25, 0},
    [FAULT_SUPERVISOR_CALL] = {EXCEPTION_HARD_FAULT, 0, HFSR_FORCED}, /* SVC while its handler may not run */
    [FAULT_VECTOR_TABLE] = {EXCEPTION_HARD_FAULT, 0, 1u << 1},
    [FAULT_BREAKPOINT] = {EXCEPTION_HARD_FAULT, 0, 1u << 31},
};
enum { FAULT_KINDS = sizeof FAULT_TABLE / sizeof FAULT_TABLE[0] };

void note_fault(
    struct machine *machine, int32_t kind, int32_t cause, uint32_t place, uint32_t address, uint32_t value,
    uint32_t size)
{
    struct machine_fault *fault = &machine->core.fault;
    if (fault->kind == FAULT_NONE)
        *fault = (struct machine_fault){kind, cause, place & ~1u, address, value, size};
}

/* Record a fault due to an EXC_RETURN or a stacked xPSR. */
static bool refuse_return(struct machine *machine, int32_t kind, int32_t cause, uint32_t place, uint32_t value)
{
    note_fault(machine, kind, cause, place, 0, value, 0);
    return false;
}

/* Set the fault status for the handler. ARMv6-M has no status registers. */
static void record(struct machine *machine, const struct machine_fault *fault, bool is_forced)
{
    struct core *core = &machine->core;
    if (machine->baseline)
        return;
    core->cfsr |= FAULT_TABLE[fault->kind].cfsr;
    core->hfsr |= FAULT_TABLE[fault->kind].hfsr | (is_forced ? HFSR_FORCED : 0);
    if (fault->kind == FAULT_DATA_BUS) {
        core->bfar = fault->address;
        core->cfsr |= CFSR_BFARVALID;
    }
}

/* -- words in memory ---------------------------------------------------------------------------------------------- */

static bool read_words(struct machine *machine, uint32_t address, uint32_t *words, uint32_t count)
{
    return machine_read(machine, address, 4 * count, (uint8_t *)words);
}

static void write_words(struct machine *machine, uint32_t address, const uint32_t *words, uint32_t count)
{
    uint8_t *place = writable_bytes(machine, address, 4 * count);
    if (place)
        memcpy(place, words, 4 * count);
    else
        machine_write(machine, address, 4 * count, (const uint8_t *)words); /* the page has code, or ends in between */
}

/* -- floating-point state ----------------------------------------------------------------------------------------- */

/* A frame that is no longer in RAM is not written. */
static void save_floating_point(struct machine *machine)
{
    struct core *core = &machine->core;
    uint32_t words[FLOATING_WORDS];
    memcpy(words, core->s, S_REGISTERS * sizeof words[0]);
    words[S_REGISTERS] = core->fpscr;
    if (machine_holds_stack(machine, core->lazy_frame, FLOATING_BYTES))
        write_words(machine, core->lazy_frame, words, FLOATING_WORDS);
    core->lazy_frame = 0;
}

static void restore_floating_point(struct machine *machine, uint32_t address)
{
    uint32_t words[FLOATING_WORDS];
    if (!read_words(machine, address, words, FLOATING_WORDS))
        return;
    memcpy(machine->core.s, words, S_REGISTERS * sizeof words[0]);
    machine->core.fpscr = words[S_REGISTERS] & FPSCR_WRITABLE;
}

void machine_save_floats(struct machine *machine)
{
    if (machine->core.lazy_frame == 0)
        return;
    forget_answers(machine); /* FPCCR has changed */
    save_floating_point(machine);
    machine->core.cycles += machine->prices.value[ROW_fp_frame];
}

/* -- entry -------------------------------------------------------------------------------------------------------- */

/* Empty the pipeline at an entry or a return, so that earlier code has no effect on later code. Both set the event
 * register (B1.5.18) and clear the local monitor (A3.4.4). */
static void start_anew(struct machine *machine)
{
    machine_flush_pipeline(machine);
    forget_answers(machine);
    machine->history.jumped_at = -1;
    machine->history.exclusive = false;
    machine->core.event = true;
}

/* Write the frame at `base`; if floating-point state is saved lazily, only reserve its room (B1.5.7). */
static void push_frame(struct machine *machine, uint32_t base, uint32_t size)
{
    struct core *core = &machine->core;
    if (!machine_holds_stack(machine, base, size)) {
        note_fault(machine, FAULT_STACKING, CAUSE_STACK_FRAME, core->r[15], base, 0, 0);
        return;
    }
    uint32_t realigned = base + size != core->r[13] ? XPSR_REALIGNED : 0;
    uint32_t frame[FRAME_WORDS] = {
        core->r[0], core->r[1], core->r[2], core->r[3], core->r[12], core->r[14], core->r[15] & ~1u,
        machine_xpsr(machine) | realigned,
    };
    write_words(machine, base, frame, FRAME_WORDS);
    if (size == EXTENDED_FRAME_BYTES) {
        core->lazy_frame = base + FRAME_BYTES;
        if ((core->is_chained && core->is_saved) || (core->floating_control & FPCCR_LSPEN) == 0)
            save_floating_point(machine);
    }
}

/* Return the vector of an exception: 0 if the table is in no memory. That fault replaces a fault of stacking. */
static uint32_t read_vector(struct machine *machine, int32_t exception)
{
    struct core *core = &machine->core;
    uint32_t address = core->vector_table + 4 * (uint32_t)exception, vector = 0;
    if (address < core->vector_table || !read_words(machine, address, &vector, 1)) {
        core->fault.kind = FAULT_NONE;
        note_fault(machine, FAULT_VECTOR_TABLE, CAUSE_VECTOR_READ, core->r[15], core->vector_table, 0, 0);
    } else if ((vector & 1) == 0) {
        note_fault(
            machine, FAULT_INVALID_STATE, CAUSE_VECTOR_THUMB, core->r[15], address, vector, (uint32_t)exception);
    }
    return vector;
}

/* A return that is directly followed by an entry has counted both (tail chaining, B1.5.12). */
static int32_t entry_cycles(const struct machine *machine, bool saves)
{
    const struct core *core = &machine->core;
    int32_t saving = saves ? machine->prices.value[ROW_fp_frame] : 0;
    if (core->is_chained)
        return core->is_saved ? 0 : saving;
    return machine->prices.value[ROW_exception_entry] + saving;
}

static uint32_t frame_flags(uint32_t exc_return)
{
    return ((exc_return & RETURN_PROCESS_STACK) != 0 ? FRAME_ON_PROCESS_STACK : 0)
        | ((exc_return & RETURN_THREAD) != 0 ? FRAME_OF_THREAD : 0);
}

/* Enter an exception (B1.5.6). A fault of the entry sets core.fault. */
static void enter(struct machine *machine, int32_t exception)
{
    struct core *core = &machine->core;
    bool extended = (core->control & CONTROL_FPCA) != 0 && (core->floating_control & FPCCR_ASPEN) != 0;
    uint32_t size = extended ? EXTENDED_FRAME_BYTES : FRAME_BYTES;
    uint32_t base = (core->r[13] - size) & ~7u;
    if (core->exception == EXCEPTION_NONE && !core->is_chained)
        core->exception_since = core->cycles;
    uint32_t exc_return = EXC_RETURN | (extended ? 0 : RETURN_BASIC_FRAME)
        | (core->exception == EXCEPTION_NONE ? RETURN_THREAD : 0)
        | (uses_process_stack(core) ? RETURN_PROCESS_STACK : 0);
    push_frame(machine, base, size);
    uint32_t vector = read_vector(machine, exception);
    calls_entered(machine, base | frame_flags(exc_return));
    core->r[13] = base;
    check_stack(machine, false, core->r[15]);
    if (uses_process_stack(core))
        stacks_handler_begins(machine);
    core->r[14] = exc_return;
    core->r[15] = vector & ~1u;
    core->thumb = vector & 1;
    core->it_state = 0;
    set_mode(core, (uint32_t)exception, core->control & CONTROL_NPRIV);
    check_stack(machine, true, core->r[15]);
    begin_exception(core, exception);
    core->cycles += entry_cycles(machine, extended && core->lazy_frame == 0);
    core->is_chained = core->is_saved = core->sleeping = false;
    start_anew(machine);
    if (exception == EXCEPTION_HARD_FAULT && core->fault.kind == FAULT_STACKING) {
        record(machine, &core->fault, false); /* no more urgent handler exists: it runs without a frame (B1.5.15) */
        core->fault.kind = FAULT_NONE;
    }
}

bool take_exception(struct machine *machine)
{
    struct core *core = &machine->core;
    int32_t ceiling = machine_ceiling(machine, false);
    int32_t exception = core->gated ? EXCEPTION_NONE : machine_next_exception(machine, ceiling);
    if (exception == EXCEPTION_NONE) {
        if (core->is_chained && core->exception == EXCEPTION_NONE)
            core->exception_cycles += core->cycles - core->exception_since;
        core->is_chained = false; /* the exception that was pending at the return has been withdrawn */
        return false;
    }
    enter(machine, exception);
    return true;
}

/* -- delivery of faults ------------------------------------------------------------------------------------------- */

/* Return the handler of a fault: its own if it is enabled and may run, otherwise HardFault's; EXCEPTION_NONE is lockup
 * (B1.5.14 and B1.5.15). */
static int32_t fault_handler(struct machine *machine, int32_t exception)
{
    int32_t priority = machine_execution_priority(machine, machine_ceiling(machine, false));
    bool is_enabled = !machine->baseline && (machine->core.fault_enabled >> exception & 1) != 0;
    if (is_enabled && machine_preemption_priority(machine, exception) < priority)
        return exception;
    bool is_lockup = priority <= machine_preemption_priority(machine, EXCEPTION_HARD_FAULT);
    return is_lockup ? EXCEPTION_NONE : EXCEPTION_HARD_FAULT;
}

/* Each handler that is entered is more urgent than the previous one, so there are at most as many as fault
 * exceptions. */
int32_t machine_deliver_fault(struct machine *machine)
{
    struct core *core = &machine->core;
    for (int32_t last = EXCEPTION_NONE; last != EXCEPTION_HARD_FAULT;) {
        struct machine_fault fault = core->fault;
        core->fault.kind = FAULT_NONE;
        if (fault.kind <= FAULT_NONE || fault.kind >= FAULT_KINDS)
            return EXCEPTION_NONE;
        int32_t exception = FAULT_TABLE[fault.kind].exception;
        last = fault_handler(machine, exception);
        if (last == EXCEPTION_NONE)
            return EXCEPTION_NONE;
        record(machine, &fault, last != exception);
        enter(machine, last);
        if (core->fault.kind == FAULT_NONE)
            return last;
    }
    core->fault.kind = FAULT_NONE; /* the entry of HardFault has failed */
    return EXCEPTION_NONE;
}

/* -- return ------------------------------------------------------------------------------------------------------- */

/* Return whether a value is an EXC_RETURN (B1.5.8); without an FPU, and in ARMv6-M, every frame is a basic one. */
static bool is_return_value(const struct machine *machine, uint32_t exc_return)
{
    switch (exc_return | (machine->baseline ? 0 : RETURN_BASIC_FRAME)) {
    case EXC_RETURN | RETURN_BASIC_FRAME:
    case EXC_RETURN | RETURN_BASIC_FRAME | RETURN_THREAD:
    case EXC_RETURN | RETURN_BASIC_FRAME | RETURN_THREAD | RETURN_PROCESS_STACK:
        return true;
    default:
        return false;
    }
}

/* Only the last active exception returns to thread mode, unless CCR.NONBASETHRDENA permits it to others (B1.5.8). */
static bool may_return(const struct machine *machine, uint32_t exc_return)
{
    const struct core *core = &machine->core;
    if (!is_return_value(machine, exc_return))
        return false;
    if ((exc_return & RETURN_THREAD) != 0)
        return active_exceptions(core) == 1 || core->base_thread_enabled;
    return active_exceptions(core) > 1;
}

/* Return the frame from which a return restores registers. False: core.fault is set, and nothing has changed. */
static bool find_frame(
    struct machine *machine, uint32_t exc_return, uint32_t place, uint32_t base, uint32_t frame[FRAME_WORDS])
{
    const struct core *core = &machine->core;
    uint32_t size = (exc_return & RETURN_BASIC_FRAME) != 0 ? FRAME_BYTES : EXTENDED_FRAME_BYTES;
    /* In thread mode an EXC_RETURN is an address from which nothing may be executed (B1.5.8). */
    if (core->exception == EXCEPTION_NONE || active_exceptions(core) == 0)
        return refuse_return(machine, FAULT_EXECUTE_NEVER, CAUSE_RETURN_THREAD, place, exc_return);
    if (!may_return(machine, exc_return))
        return refuse_return(machine, FAULT_INVALID_RETURN, CAUSE_RETURN_VALUE, place, exc_return);
    if (!machine_holds_stack(machine, base, size) || !read_words(machine, base, frame, FRAME_WORDS)) {
        note_fault(machine, FAULT_UNSTACKING, CAUSE_STACK_FRAME, place, base, 0, 0);
        return false;
    }
    bool is_thread_frame = (frame[FRAME_XPSR] & XPSR_EXCEPTION) == 0;
    if (is_thread_frame != ((exc_return & RETURN_THREAD) != 0))
        return refuse_return(machine, FAULT_INVALID_RETURN, CAUSE_RETURN_MODE, place, frame[FRAME_XPSR]);
    return true;
}

/* Restore floating-point state from an extended frame, unless the registers still hold it, because it was never saved.
 * Returns whether it had to be read. A basic frame does not affect state that waits to be saved. */
static bool unstack_floating_point(struct machine *machine, uint32_t exc_return, uint32_t base)
{
    struct core *core = &machine->core;
    if ((exc_return & RETURN_BASIC_FRAME) != 0)
        return false;
    bool restores = core->lazy_frame == 0;
    if (restores)
        restore_floating_point(machine, base + FRAME_BYTES);
    core->lazy_frame = 0;
    return restores;
}

static void deactivate(struct machine *machine)
{
    struct core *core = &machine->core;
    if (last_active(core) != EXCEPTION_NMI)
        core->faultmask = 0; /* a return from NMI does not clear it (B1.5.8) */
    end_exception(core);
    machine->must_check = true;
}

static void unstack(struct machine *machine, uint32_t exc_return, uint32_t base, const uint32_t frame[FRAME_WORDS])
{
    struct core *core = &machine->core;
    uint32_t size = (exc_return & RETURN_BASIC_FRAME) != 0 ? FRAME_BYTES : EXTENDED_FRAME_BYTES;
    uint32_t control = (core->control & CONTROL_NPRIV)
        | ((exc_return & RETURN_PROCESS_STACK) != 0 ? CONTROL_SPSEL : 0)
        | ((exc_return & RETURN_BASIC_FRAME) == 0 ? CONTROL_FPCA : 0);
    set_mode(core, core->exception, control);
    machine_set_xpsr(machine, frame[FRAME_XPSR]);
    core->r[13] = base + size + ((frame[FRAME_XPSR] & XPSR_REALIGNED) != 0 ? 4 : 0);
    memcpy(core->r, frame, 4 * sizeof frame[0]);
    core->r[12] = frame[4];
    core->r[14] = frame[FRAME_LR];
    core->r[15] = frame[FRAME_PC] & ~1u;
}

/* Return the cycles of a return: to the interrupted code, or to the handler that follows directly (B1.5.12). */
static int32_t return_cycles(struct machine *machine, bool restores)
{
    struct core *core = &machine->core;
    const struct prices *prices = &machine->prices;
    bool is_chained = prices->has[ROW_tail_chain]
        && machine_next_exception(machine, machine_ceiling(machine, false)) != EXCEPTION_NONE;
    if (is_chained) {
        core->is_chained = true;
        core->is_saved = restores;
        return prices->value[ROW_tail_chain];
    }
    return prices->value[ROW_exception_return] + (restores ? prices->value[ROW_fp_frame] : 0);
}

bool leave_exception(struct machine *machine, uint32_t exc_return, uint32_t place)
{
    struct core *core = &machine->core;
    uint32_t base = machine_stack_pointer(machine, (exc_return & RETURN_PROCESS_STACK) != 0);
    uint32_t frame[FRAME_WORDS];
    exc_return |= 1;
    if (!find_frame(machine, exc_return, place, base, frame))
        return false;
    if ((exc_return & RETURN_PROCESS_STACK) != 0)
        stacks_handler_ends(machine);
    bool restores = unstack_floating_point(machine, exc_return, base);
    deactivate(machine);
    unstack(machine, exc_return, base, frame);
    start_anew(machine);
    int32_t cycles = core->thumb ? return_cycles(machine, restores) : 0;
    calls_left(machine, base | frame_flags(exc_return), cycles, place);
    check_stack(machine, true, core->r[15]);
    if (!core->thumb) {
        uint32_t xpsr = frame[FRAME_XPSR] & ~(uint32_t)XPSR_REALIGNED;
        return refuse_return(machine, FAULT_INVALID_STATE, CAUSE_RETURN_THUMB, core->r[15], xpsr);
    }
    core->cycles += cycles;
    if (core->exception == EXCEPTION_NONE && !core->is_chained)
        core->exception_cycles += core->cycles - core->exception_since;
    core->waits_for_event = false;
    core->sleeping = core->sleeps_on_exit && active_exceptions(core) == 0;
    return true;
}

/* -- sleep -------------------------------------------------------------------------------------------------------- */

/* Consume the event that ends a WFE (B1.5.18): with SCR.SEVONPEND a newly pending exception is one. */
static bool take_event(struct core *core)
{
    bool is_set = core->event || (core->sends_on_pend && core->newly_pending);
    core->event = core->newly_pending = false;
    return is_set;
}

/* If an event wakes the core, it is consumed. PRIMASK does not keep WFI asleep (B1.5.19). */
bool is_woken(struct machine *machine, bool for_event)
{
    if (machine->core.gated)
        return false;
    if (machine_next_exception(machine, machine_ceiling(machine, !for_event)) != EXCEPTION_NONE)
        return true;
    return for_event && take_event(&machine->core);
}
