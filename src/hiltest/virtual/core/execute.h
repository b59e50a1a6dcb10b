/* The interpreter. */
#ifndef HILTEST_EXECUTE_H
#define HILTEST_EXECUTE_H

#include "code.h"

enum outcome {
    RAN,      /* until the horizon, or to an instruction that has no node yet */
    FAULTED,  /* core.fault is set */
    LOOPED,   /* at a branch to itself */
    SLEPT,    /* behind WFI or WFE */
    BROKE,    /* at a breakpoint */
    LEFT,     /* by a branch to EXC_RETURN, which is in `machine->history.exc_return` */
};

/* Execute from a node on, at least one instruction, until one begins at or after the cycle `horizon`. `horizon` is
 * lowered to core.deadline if that is lower, and to nothing if machine->looks is set. Afterwards r15, it_state and
 * machine->history.pipeline are of the next instruction. */
enum outcome execute(struct machine *machine, struct node *node, int64_t horizon);
/* The same on a machine whose memories add waits. */
enum outcome execute_with_waits(struct machine *machine, struct node *node, int64_t horizon);

/* machine.c: the node of the next instruction; NULL with core.fault set if there is none. */
struct node *next_node(struct machine *machine);
/* Execute from a node on as `execute` does. Returns a reason to stop, or -1. */
int32_t execute_from(struct machine *machine, struct node *node, int64_t horizon);

#endif
