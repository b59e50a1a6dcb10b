/* Depths of the firmware's stacks, from the values of its stack pointer.
 *
 * A stack is a range of addresses that the stack pointer has had without a jump: instructions and exception frames
 * lower it. If the stack pointer is set to an address outside all known ranges, such as a new task's, a new stack
 * begins at it. Memory is not filled with a pattern.
 */
#include "stacks.h"

#include <string.h>

static bool holds(const struct machine_stack *stack, uint32_t address)
{
    return stack->lowest <= address && address <= stack->top;
}

/* Return the number of the stack that an address belongs to, or -1. */
static int32_t stack_with(const struct stacks *stacks, uint32_t address)
{
    for (int32_t i = 0; i < stacks->count; i++)
        if (holds(&stacks->entries[i], address))
            return i;
    return -1;
}

/* If the table is full, the newest stack is dropped. */
static int32_t begin_stack(struct stacks *stacks, uint32_t top, uint32_t pc)
{
    if (stacks->count < MOST_STACKS)
        stacks->count++;
    stacks->entries[stacks->count - 1] = (struct machine_stack){.top = top, .lowest = top, .first_pc = pc};
    return stacks->count - 1;
}

static void lower(uint32_t *lowest, uint32_t address)
{
    if (address < *lowest)
        *lowest = address;
}

/* Drop the stacks whose top is in the range of another one: they were first seen below their top, or the stack above
 * has overflowed into them. Returns the new number of the stack that stays. */
static int32_t merge(struct stacks *stacks, int32_t number)
{
    struct machine_stack stack = stacks->entries[number];
    const uint32_t lowest = stack.lowest;
    int32_t remaining = 0, place = number;
    for (int32_t i = 0; i < stacks->count; i++) {
        const struct machine_stack other = stacks->entries[i];
        if (i != number && lowest < other.top && other.top <= stack.top) {
            lower(&stack.lowest, other.lowest);
            continue;
        }
        if (i == number)
            place = remaining;
        stacks->entries[remaining++] = other;
    }
    stacks->count = remaining;
    stacks->entries[place] = stack;
    return place;
}

/* Set the range in which the stack pointer may move without a check. While calls are watched it ends at the lowest
 * stack pointer since the last check. */
static void set_range(struct machine *machine)
{
    const struct machine_stack *stack = &machine->history.stacks.entries[machine->history.stacks.current];
    uint32_t lowest = machine->history.stacks.lowest > stack->lowest ? machine->history.stacks.lowest : stack->lowest;
    machine->history.stack_lowest = lowest;
    machine->history.stack_used = stack->top - lowest;
}

void stack_moves(struct machine *machine, bool jumps, uint32_t pc)
{
    struct stacks *stacks = &machine->history.stacks;
    const uint32_t pointer = machine->core.r[13];
    if (stacks->count == 0 || !holds(&stacks->entries[stacks->current], pointer)) {
        /* A descent that began without a jump. */
        bool descends = !jumps && stacks->count && pointer < stacks->entries[stacks->current].lowest;
        int32_t number = descends ? stacks->current : stack_with(stacks, pointer);
        if (number < 0)
            number = begin_stack(stacks, pointer, pc & ~1u);
        lower(&stacks->entries[number].lowest, pointer);
        stacks->current = merge(stacks, number);
    }
    if (pointer < stacks->lowest)
        stacks->lowest = pointer;
    set_range(machine);
}

void stacks_record_lowest(struct machine *machine, bool seeks)
{
    if (seeks) {
        machine->history.stacks.lowest = machine->core.r[13];
        stack_moves(machine, true, machine->core.r[15]);
    } else if (machine->history.stacks.lowest) {
        machine->history.stacks.lowest = 0;
        set_range(machine);
    }
}

void machine_forget_stacks(struct machine *machine)
{
    machine->history.stacks.count = 0;
    machine->history.stack_lowest = UINT32_MAX; /* no stack pointer is in the range */
    machine->history.stack_used = 0;
}

uint32_t stacks_used(const struct machine *machine, uint32_t above, uint32_t lowest)
{
    for (int32_t i = 0; i < machine->history.stacks.count; i++) {
        const struct machine_stack *stack = &machine->history.stacks.entries[i];
        if (stack->lowest <= lowest && above <= stack->top)
            return above - lowest;
    }
    return UINT32_MAX;
}

/* A kernel that switches tasks saves their other registers below the frame of a thread's exception, while the handler
 * uses another stack, so that the stack pointer never shows it. */
void stacks_handler_begins(struct machine *machine)
{
    struct stacks *stacks = &machine->history.stacks;
    const uint32_t below = machine->core.r[13] - CONTEXT_BYTES;
    stacks->has_context = below < stacks->entries[stacks->current].lowest
        && machine_read(machine, below, CONTEXT_BYTES, stacks->context);
    stacks->below = below;
}

void stacks_handler_ends(struct machine *machine)
{
    struct stacks *stacks = &machine->history.stacks;
    uint8_t context[CONTEXT_BYTES];
    if (!stacks->has_context)
        return;
    stacks->has_context = false;
    int32_t number = stack_with(stacks, stacks->below + CONTEXT_BYTES);
    if (number < 0 || !machine_read(machine, stacks->below, CONTEXT_BYTES, context))
        return;
    uint32_t first = 0;
    while (first < CONTEXT_BYTES && memcmp(context + first, stacks->context + first, 4) == 0)
        first += 4;
    if (first < CONTEXT_BYTES) {
        lower(&stacks->entries[number].lowest, stacks->below + first);
        set_range(machine);
    }
}

const struct machine_stack *machine_stacks(struct machine *machine, int32_t *count)
{
    *count = machine->history.stacks.count;
    return machine->history.stacks.entries;
}
