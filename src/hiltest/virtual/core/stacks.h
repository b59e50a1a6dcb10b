/* Depths of the firmware's stacks. */
#ifndef HILTEST_STACKS_H
#define HILTEST_STACKS_H

#include "state.h"

/* Called when the stack pointer has left the range stack_lowest to stack_lowest + stack_used. `jumps`: it was set, not
 * lowered or raised. `pc` is the next instruction. */
void stack_moves(struct machine *machine, bool jumps, uint32_t pc);
static inline void check_stack(struct machine *machine, bool jumps, uint32_t pc)
{
    if (machine->core.r[13] - machine->history.stack_lowest > machine->history.stack_used)
        stack_moves(machine, jumps, pc);
}
/* Start or stop recording the lowest value of the stack pointer in `stacks.lowest`. */
void stacks_record_lowest(struct machine *machine, bool records);
/* Return the bytes between two values of the stack pointer; UINT32_MAX if they are on different stacks. */
uint32_t stacks_used(const struct machine *machine, uint32_t above, uint32_t lowest);
/* Called when an exception has interrupted code on the process stack and its handler begins; r13 is the address of the
 * frame. */
void stacks_handler_begins(struct machine *machine);
void stacks_handler_ends(struct machine *machine);

#endif
