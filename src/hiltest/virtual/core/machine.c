/* Creation, reset and execution of a machine. */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "execute.h"
#include "stacks.h"

enum { SLICE_CYCLES = 4000000 }; /* about 10 ms of wall time */
/* Delay after an event before looking for a waiting loop, and its upper limit, see patience_in_loop. */
enum { FIRST_LOOK_CYCLES = 256, MOST_LOOK_CYCLES = 16384 };

struct machine *machine_create(bool baseline)
{
    struct machine *machine = calloc(1, sizeof *machine);
    if (!machine)
        return NULL;
    machine->readable = calloc(PAGES, sizeof *machine->readable);
    machine->writable = calloc(PAGES, sizeof *machine->writable);
    machine->code = code_create();
    if (!machine->readable || !machine->writable || !machine->code) {
        machine_destroy(machine);
        return NULL;
    }
    machine->baseline = baseline;
    machine->core.interrupts = 240;
    machine->core.priority_mask = baseline ? 0xC0 : 0xF0;
    machine->core.instruction_limit = INT64_MAX;
    machine->core.return_address = UINT32_MAX;
    machine_reset(machine);
    return machine;
}

void machine_destroy(struct machine *machine)
{
    if (!machine)
        return;
    for (int i = 0; i < machine->memory_count; i++) {
        if (machine->memories[i].is_alias)
            continue;
        free(machine->memories[i].bytes);
        free(machine->memories[i].has_code);
        free(machine->memories[i].executions);
        destroy_copies(&machine->memories[i]);
    }
    forget_devices(machine);
    profile_destroy(machine);
    free(machine->turn);
    code_destroy(machine->code);
    calls_destroy(machine);
    free(machine->tables);
    free(machine->waits);
    free(machine->readable);
    free(machine->writable);
    free(machine);
}

struct core *machine_core(struct machine *machine) { return &machine->core; }

void machine_connect(struct machine *machine, struct machine_bus bus) { machine->bus = bus; }

bool machine_set_price(struct machine *machine, int32_t table, const char *row, int32_t value)
{
    if (table && (table < 0 || table >= machine->table_count))
        return false;
    machine->code_changed = machine->must_check = true;
    return set_price(table ? &machine->tables[table - 1] : &machine->prices, row, value);
}

/* Return the waits of the memories, which begin with the first call; NULL if out of memory. */
static struct memory_waits *waits_of(struct machine *machine)
{
    if (!machine->waits) {
        machine->waits = malloc(sizeof *machine->waits);
        if (machine->waits)
            waits_begin(machine->waits);
    }
    return machine->waits;
}

bool machine_set_memory_row(struct machine *machine, const char *row, int32_t value)
{
    return waits_of(machine) && set_memory_row(machine->waits, row, value);
}

bool machine_add_block(struct machine *machine, uint32_t begin)
{
    if (machine->block_count == BLOCKS)
        return false;
    machine->blocks[machine->block_count++] = begin;
    return true;
}

bool machine_set_flash(struct machine *machine, uint32_t begin, uint32_t bytes)
{
    if (waits_of(machine))
        waits_set_flash(machine->waits, (struct address_range){begin, bytes});
    return machine->waits;
}

bool machine_add_late_ram(struct machine *machine, uint32_t begin, uint32_t bytes)
{
    return waits_of(machine) && waits_add_late_ram(machine->waits, (struct address_range){begin, bytes});
}

void machine_switch_flash_bank(
    struct machine *machine, uint32_t bank, bool keeps_line, bool reads_ahead_code, bool reads_ahead_data,
    bool caches_code, bool caches_data)
{
    const struct bank_switches switches = {
        keeps_line, reads_ahead_code, reads_ahead_data, caches_code, caches_data};
    if (machine->waits)
        waits_switch(machine->waits, bank, switches);
}

void machine_forget_flash_lines(struct machine *machine)
{
    if (machine->waits)
        waits_forget_lines(machine->waits);
}

void machine_forget_flash_way(struct machine *machine, uint32_t way)
{
    if (machine->waits)
        waits_forget_way(machine->waits, way);
}

bool machine_set_breakpoint(struct machine *machine, uint32_t address, bool set)
{
    return code_set_mark(machine, address, MARK_BREAKPOINT, set);
}

void machine_set_fpu(struct machine *machine, bool enabled)
{
    if (machine->core.fpu_enabled != enabled) {
        machine->core.fpu_enabled = enabled;
        machine->code_changed = machine->must_check = true;
    }
}

void machine_flush_pipeline(struct machine *machine)
{
    memset(&machine->history.pipeline, 0, sizeof machine->history.pipeline);
    if (machine->waits)
        waits_flush(machine->waits);
}

/* DDI 0403E, B1.5.5: the state of the processor after a reset, without the vector table's first two words. */
void machine_reset(struct machine *machine)
{
    struct core *core = &machine->core;
    memset(core->r, 0, offsetof(struct core, taken) - offsetof(struct core, r));
    core->passes_breakpoint = false;
    core->watch_kinds = 0;
    core->r[14] = 0xFFFFFFFF;
    core->thumb = 1;
    core->zero = 1;
    core->floating_control = 3u << 30; /* FPCCR: ASPEN and LSPEN */
    machine->history.exclusive = machine->history.stacks.has_context = false;
    calls_reset(machine);
    if (machine->waits)
        waits_reset(machine->waits);
    machine->code_changed = machine->must_check = true;
    machine_flush_pipeline(machine);
}

/* Return whether the architecture forbids code at an address: devices, and the system region (DDI 0403E, B3.1). */
static bool is_never_executed(uint32_t address)
{
    return (address >= 0x40000000 && address < 0x60000000) || address >= 0xA0000000;
}

static void note_fetch_fault(struct machine *machine)
{
    uint32_t address = machine->core.r[15];
    if (memory_at(machine, address, 2))
        address += 2; /* the memory ends within an instruction of four bytes */
    int32_t kind = is_never_executed(address) ? FAULT_EXECUTE_NEVER : FAULT_INSTRUCTION_BUS;
    note_fault(machine, kind, CAUSE_FETCH_UNMAPPED, machine->history.previous, address, 0, 0);
}

struct node *next_node(struct machine *machine)
{
    struct core *core = &machine->core;
    uint32_t address = core->r[15];
    bool has_memory = memory_at(machine, address, 2);
    if (!core->thumb) {
        uint32_t place = has_memory ? address : machine->history.previous;
        note_fault(machine, FAULT_INVALID_STATE, CAUSE_NO_THUMB_BIT, place, address, 0, 0);
        return NULL;
    }
    if (machine->code_changed || code_is_full(machine))
        code_forget(machine);
    struct node *node =
        has_memory ? code_at(machine, address, (uint8_t)core->it_state, code_next_state(machine)) : NULL;
    if (!node)
        note_fetch_fault(machine);
    return node;
}

bool machine_wakes(struct machine *machine)
{
    return !machine->core.gated && is_woken(machine, machine->core.waits_for_event);
}

/* Enter pending exceptions, and wake up for them; false if the core continues to sleep. */
static bool attend(struct machine *machine)
{
    struct core *core = &machine->core;
    machine->must_check = machine->code_changed;
    if (core->gated)
        return !core->sleeping;
    if (core->sleeping && is_woken(machine, core->waits_for_event))
        core->sleeping = false;
    if (take_exception(machine))
        core->passes_breakpoint = false;
    return !core->sleeping;
}

/* Execute until a check is needed. Returns an enum stop_reason, or -1 to continue. */
static int32_t go_on(struct machine *machine, int64_t slice_end)
{
    struct core *core = &machine->core;
    if (core->r[15] == core->return_address && !core->delivers_faults)
        return STOP_RETURNED;
    struct node *node = next_node(machine);
    if (!node)
        return STOP_FAULT;
    return execute_from(machine, node, slice_end);
}

int32_t execute_from(struct machine *machine, struct node *node, int64_t horizon)
{
    struct core *core = &machine->core;
    machine->must_check = false;
    switch (machine->waits ? execute_with_waits(machine, node, horizon) : execute(machine, node, horizon)) {
    case FAULTED:
        counts_fault(machine, core->r[15]);
        machine_flush_pipeline(machine);
        return STOP_FAULT;
    case LOOPED:
        return STOP_LOOP;
    case BROKE:
        return STOP_BREAKPOINT;
    case LEFT:
        if (!leave_exception(machine, machine->history.exc_return, machine->history.previous))
            return STOP_FAULT;
        if (core->fault.kind)
            return STOP_FAULT;
        return core->reports_returns ? STOP_UNSTACKED : -1;
    default:
        return -1;
    }
}

/* Advance time in sleep to the next event. False if the caller of machine_run has to handle the sleep. */
static bool sleep_on(struct machine *machine)
{
    struct core *core = &machine->core;
    const int64_t target = earlier(core->deadline, machine_next_event(machine));
    if (core->sleeps_deeply || core->leaves_sleep || core->gated || target == NEVER
        || !machine_can_ever_wake(machine, machine_ceiling(machine, !core->waits_for_event)))
        return false;
    if (target > core->cycles) {
        core->idle_cycles += target - core->cycles;
        core->cycles = target;
    }
    return true;
}

/* Return whether an event has fired that the host waits for. */
static bool concerns_host(const struct machine *machine)
{
    int32_t stops_at = machine->core.stops_at;
    return (stops_at == HOST_ANY && machine->has_fired) || (stops_at == HOST_BYTES && machine->host_notified);
}

static int32_t run(struct machine *machine)
{
    struct core *core = &machine->core;
    int64_t slice_end = core->cycles + SLICE_CYCLES, pace = FIRST_LOOK_CYCLES, look_at = core->cycles + pace;
    core->fault.kind = FAULT_NONE;
    check_stack(machine, true, core->r[15]); /* the host may have set the stack pointer */
    machine->has_fired = machine->host_notified = false;
    for (;;) {
        if (machine_next_event(machine) <= core->cycles)
            look_at = core->cycles + (pace = FIRST_LOOK_CYCLES);
        machine_fire_events(machine);
        if (concerns_host(machine))
            return STOP_HOST;
        if (core->watch_kinds)
            return STOP_WATCHPOINT;
        if (core->cycles >= core->deadline)
            return STOP_DEADLINE;
        if (core->cycles >= slice_end)
            return STOP_TURNS;
        if (!attend(machine)) {
            if (!sleep_on(machine))
                return STOP_SLEEP;
            continue;
        }
        if (core->fault.kind)
            return STOP_FAULT;
        const int64_t until = earlier(slice_end, earlier(core->deadline, machine_next_event(machine)));
        if (core->cycles >= until)
            continue; /* the deadline has passed during the entry of an exception */
        if (core->instructions >= core->instruction_limit)
            return STOP_STEP;
        int32_t reason;
        int32_t *patience = machine->answer_cache.polled ? &machine->answer_cache.polled->patience : NULL;
        const int32_t least = patience ? FIRST_PATIENCE : LEAST_SAMPLES;
        if (!patience && core->cycles >= look_at) {
            patience = patience_in_loop(machine);
            pace = patience ? FIRST_LOOK_CYCLES : earlier(2 * pace, MOST_LOOK_CYCLES);
            look_at = core->cycles + pace;
        }
        if (patience)
            reason = pass_turns(machine, until, patience, least);
        else
            reason = go_on(machine, core->instruction_limit == INT64_MAX ? earlier(slice_end, look_at) : INT64_MIN);
        if (reason >= 0)
            return reason;
    }
}

int32_t machine_run(struct machine *machine)
{
    const int32_t reason = run(machine);
    forget_answers(machine);
    return reason;
}
