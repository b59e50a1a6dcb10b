/* Execution counts of instructions by address, which are kept when the nodes are dropped. */
#include <stdlib.h>

#include "code.h"

bool machine_watch_executions(struct machine *machine)
{
    for (int i = 0; i < machine->memory_count; i++) {
        struct memory *memory = &machine->memories[i];
        if (memory->is_alias)
            continue; /* code runs at the memory's own address */
        if (!memory->executions)
            memory->executions = calloc(memory->size / 2, sizeof *memory->executions);
        if (!memory->executions)
            return false;
    }
    counts_drop(machine);
    machine->watches_executions = true;
    return true;
}

const struct machine_executions *machine_executions(struct machine *machine, uint32_t base)
{
    const struct memory *memory = memory_at(machine, base, 2);
    if (!memory || !machine->watches_executions)
        return NULL;
    counts_fold(machine);
    return memory->executions;
}

static void add(struct machine *machine, uint32_t address, uint64_t executed, uint64_t jumped)
{
    struct memory *memory = memory_at(machine, address, 2);
    if (!memory || !memory->executions)
        return;
    struct machine_executions *counts = &memory->executions[(address - memory->base) / 2];
    counts->executed += executed;
    counts->jumped += jumped;
}

void counts_drop(struct machine *machine)
{
    for (uint32_t i = 0; i < code_count(machine); i++) {
        struct node *node = code_node(machine, i);
        node->runs = node->jumps = node->skips = 0;
        node->waited = 0;
    }
}

void counts_fold(struct machine *machine)
{
    if (!machine->watches_executions && !machine->profiles)
        return;
    for (uint32_t i = 0; i < code_count(machine); i++) {
        const struct node *node = code_node(machine, i);
        if (node->runs || node->jumps)
            add(machine, node->address, node->runs + node->jumps, node->jumps);
        if (machine->profiles)
            profile_add(machine, node);
    }
    counts_drop(machine);
}

void counts_fault(struct machine *machine, uint32_t address)
{
    if (machine->watches_executions)
        add(machine, address, 1, 0);
}
