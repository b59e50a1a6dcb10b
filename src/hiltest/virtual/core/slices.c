/* Slices of an execution, executed again on another machine and counted by several price tables at once. */
#include <stdlib.h>

#include "code.h"

bool machine_set_tables(struct machine *machine, int32_t count)
{
    struct prices *tables = count > 0 ? calloc((size_t)count, sizeof *tables) : NULL;
    if (!tables || !code_set_tables(machine, (uint32_t)count)) {
        free(tables);
        return false;
    }
    for (int32_t table = 1; table < count; table++)
        tables[table - 1] = machine->prices;
    free(machine->tables);
    machine->tables = tables;
    machine->table_count = count;
    return true;
}

bool machine_answers(struct machine *machine, int64_t first, int32_t count, uint32_t *answers)
{
    const int64_t loads = machine->core.device_loads;
    if (first < machine->oldest_answer || count < 0 || first + count > loads || loads - first > ANSWERS)
        return false;
    for (int32_t i = 0; i < count; i++)
        answers[i] = machine->answers[(first + i) % ANSWERS];
    return true;
}

/* The devices of a slice during its repetition. */
struct recording {
    const struct slice *slice;
    int32_t answered; /* number of repeated answers */
    bool is_over;  /* a further answer was requested */
};

/* Without a recording every answer is zero. */
static uint32_t answer(void *context, uint32_t address, uint32_t size, bool *refused)
{
    struct recording *recording = context;
    (void)address;
    (void)size;
    if (!recording)
        return 0;
    if (recording->answered < recording->slice->answer_count)
        return recording->slice->answers[recording->answered++];
    *refused = recording->is_over = true; /* a bus fault ends the run, and its instruction is not counted */
    return 0;
}

static void ignore(void *context, uint32_t address, uint32_t size, uint32_t value, bool *refused)
{
    (void)context;
    (void)address;
    (void)size;
    (void)value;
    (void)refused;
}

/* Disable interrupts, because requests of devices are not part of a slice. */
static void mask_exceptions(struct core *core)
{
    for (int word = 0; word < EXCEPTION_WORDS; word++)
        core->pending[word] = core->lines[word] = core->enabled[word] = 0;
}

/* Drop the nodes, because they are linked across an address that was not the return address before. */
static void set_return_address(struct machine *machine, uint32_t address)
{
    if (machine->core.return_address != address)
        machine->code_changed = true;
    machine->core.return_address = address;
}

/* Run until a stop for another reason than STOP_TURNS. */
static int32_t run_on(struct machine *machine, struct machine_bus bus)
{
    int32_t reason;
    machine->bus = bus;
    machine->core.delivers_faults = false;
    mask_exceptions(&machine->core);
    do
        reason = machine_run(machine);
    while (reason == STOP_TURNS);
    return reason;
}

static bool run_slice(struct machine *machine, const struct slice *slice)
{
    struct recording recording = {slice, 0, false};
    int32_t reason = run_on(machine, (struct machine_bus){&recording, answer, ignore});
    bool returns = reason == STOP_RETURNED && recording.answered == slice->answer_count;
    return returns || (reason == STOP_FAULT && recording.is_over);
}

bool machine_count_again(struct machine *machine, const struct slice *slice, int64_t *totals)
{
    struct core *core = &machine->core;
    if (machine->table_count < 1 || !machine_restore(machine, slice->begin))
        return false;
    const int64_t cycles = core->cycles, instructions = core->instructions, waited = core->memory_cycles;
    core->deadline = cycles + slice->cycles + 1;
    set_return_address(machine, machine_snapshot_core(slice->begin)->return_address);
    counts_drop(machine);
    if (!run_slice(machine, slice) || core->cycles - cycles != slice->cycles
        || core->instructions - instructions != slice->instructions)
        return false;
    /* Time outside instructions, in sleep or in the entry of an exception, is in no table. Memories wait as long by all
     * tables. */
    const int64_t waits = core->memory_cycles - waited;
    int64_t sums[MOST_TABLES] = {0};
    code_add_cycles(machine, sums);
    if (sums[0] + waits != slice->cycles)
        return false;
    for (int32_t table = 0; table < machine->table_count; table++)
        totals[table] += sums[table] + waits;
    return true;
}

bool machine_call_again(struct machine *machine, const struct snapshot *begin, int64_t most_cycles)
{
    struct core *core = &machine->core;
    struct memory_waits held;
    if (machine->waits)
        held = *machine->waits;
    if (!machine_restore(machine, begin))
        return false;
    if (machine->waits) {
        *machine->waits = held;
        machine->waits->free_at = core->cycles;
    }
    machine_flush_pipeline(machine); /* earlier code must not affect the call */
    const uint32_t stack = core->r[13];
    core->deadline = core->cycles + most_cycles;
    set_return_address(machine, core->r[14] & ~1u);
    return run_on(machine, (struct machine_bus){NULL, answer, ignore}) == STOP_RETURNED && core->r[13] == stack;
}
