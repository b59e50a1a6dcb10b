/* How deep the stacks of firmware have been. */
#ifndef HILTEST_STACKS_H
#define HILTEST_STACKS_H

#include "state.h"

/* The stack pointer has left the range stack_lowest to stack_lowest + stack_used. It jumps if it was set, and not
 * lowered or raised. `pc` is the next instruction. */
void stack_moves(struct machine *machine, bool jumps, uint32_t pc);
static inline void look_at_stack(struct machine *machine, bool jumps, uint32_t pc)
{
    if (machine->core.r[13] - machine->history.stack_lowest > machine->history.stack_used)
        stack_moves(machine, jumps, pc);
}
/* From now on have `stacks.lowest` be the lowest address of the stack pointer, or nobody wants to know it. */
void stacks_seek_lowest(struct machine *machine, bool wanted);
/* Bytes between two addresses of the stack pointer; UINT32_MAX if two stacks lie between. */
uint32_t stacks_used(const struct machine *machine, uint32_t above, uint32_t lowest);
/* The handler of an exception begins that has interrupted code on the process stack, whose frame r13 is at, and it
 * returns there. */
void stacks_handler_begins(struct machine *machine);
void stacks_handler_ends(struct machine *machine);

#endif
