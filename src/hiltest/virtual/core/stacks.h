/* Depths of the firmware's stacks. */
#ifndef HILTEST_STACKS_H
#define HILTEST_STACKS_H

#include "state.h"

/* Called when the stack pointer has left the range stack_lowest to stack_lowest + stack_used. It jumps if it was set
 * instead of lowered or raised. `pc` is the next instruction. */
void stack_moves(struct machine *machine, bool jumps, uint32_t pc);
static inline void look_at_stack(struct machine *machine, bool jumps, uint32_t pc)
{
    if (machine->core.r[13] - machine->history.stack_lowest > machine->history.stack_used)
        stack_moves(machine, jumps, pc);
}
/* Begin or stop recording the lowest address of the stack pointer in `stacks.lowest`. */
void stacks_seek_lowest(struct machine *machine, bool seeks);
/* Return the bytes between two addresses of the stack pointer; UINT32_MAX if they are on two stacks. */
uint32_t stacks_used(const struct machine *machine, uint32_t above, uint32_t lowest);
/* Called when the handler of an exception begins that has interrupted code on the process stack, to which it returns;
 * r13 is at its frame. */
void stacks_handler_begins(struct machine *machine);
void stacks_handler_ends(struct machine *machine);

#endif
