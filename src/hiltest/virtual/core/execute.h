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
 * lowered to core.deadline if that is lower, and to zero if machine->looks is set. Afterwards r15, it_state and
 * machine->history.pipeline belong to the next instruction. */
enum outcome execute(struct machine *machine, struct node *node, int64_t horizon);
/* The same on a machine whose memories add waits. */
enum outcome execute_with_waits(struct machine *machine, struct node *node, int64_t horizon);

/* machine.c: the node of the next instruction; NULL with core.fault set if there is none. */
struct node *next_node(struct machine *machine);
/* Execute from a node on as `execute` does. Returns a reason to stop, or -1. */
int32_t execute_from(struct machine *machine, struct node *node, int64_t horizon);

/* system.c: special registers and masks, as accessed by MRS, MSR and CPS (DDI 0403E, B5.2). */
uint32_t read_special(struct machine *machine, uint32_t number);
/* `mask` bit 1 writes the flags of APSR, bit 0 GE. */
void write_special(struct machine *machine, uint32_t number, uint32_t mask, uint32_t value);
void change_masks(struct machine *machine, const struct instruction *instruction);

/* transfers.c: instructions that transfer several words, or that use the exclusive monitor.
 *
 * Each returns false if it faults: core.fault is then set and no base register has been written back, though some words
 * may have been transferred (DDI 0403E, B1.5.9: the base is restored, so that the instruction can be restarted).
 */
/* Return the address of the first word of a transfer of `words` words, before it is executed. */
uint32_t transfer_address(const struct core *core, const struct instruction *instruction);

/* LDM and POP; *target is the value loaded into the PC, if it is in the list. */
bool load_multiple(struct machine *machine, const struct instruction *instruction, uint32_t *target);
bool store_multiple(struct machine *machine, const struct instruction *instruction);
bool load_double(struct machine *machine, const struct instruction *instruction);
bool store_double(struct machine *machine, const struct instruction *instruction);
bool load_exclusive(struct machine *machine, const struct instruction *instruction, uint32_t size);
bool store_exclusive(struct machine *machine, const struct instruction *instruction, uint32_t size);
/* VLDR and VSTR, VLDM and VSTM. */
bool load_floats(struct machine *machine, const struct instruction *instruction);
bool store_floats(struct machine *machine, const struct instruction *instruction);

#endif
