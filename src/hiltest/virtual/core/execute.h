/* The interpreter. */
#ifndef HILTEST_EXECUTE_H
#define HILTEST_EXECUTE_H

#include "code.h"

enum outcome {
    RAN,      /* up to the horizon, or to an instruction without a node */
    FAULTED,  /* core.fault is set */
    LOOPED,   /* at a branch to itself */
    SLEPT,    /* after WFI or WFE */
    BROKE,    /* at a breakpoint */
    LEFT,     /* at a branch to EXC_RETURN, whose value is in `machine->history.exc_return` */
};

/* Execute at least one instruction, beginning with a node, until an instruction begins at or after the cycle `horizon`.
 * `horizon` is lowered to core.deadline if that is lower, and to zero if machine->must_check is set. Afterwards r15,
 * it_state and machine->history.pipeline belong to the next instruction. */
enum outcome execute(struct machine *machine, struct node *node, int64_t horizon);
/* The same on a machine whose memories add waits. */
enum outcome execute_with_waits(struct machine *machine, struct node *node, int64_t horizon);

/* machine.c: the node of the next instruction; NULL with core.fault set if there is none. */
struct node *next_node(struct machine *machine);
/* Execute from a node on as `execute` does; return an enum stop_reason, or -1 to continue. */
int32_t execute_from(struct machine *machine, struct node *node, int64_t horizon);

/* system.c: special registers and masks, as accessed by MRS, MSR and CPS (DDI 0403E, B5.2). */
uint32_t read_special(struct machine *machine, uint32_t number);
/* `mask` bit 1 writes the flags of APSR, bit 0 GE. */
void write_special(struct machine *machine, uint32_t number, uint32_t mask, uint32_t value);
void change_masks(struct machine *machine, const struct instruction *instruction);

/* transfers.c: instructions that transfer several words, or that use the exclusive monitor.
 *
 * Each function returns false on a fault: core.fault is then set, and the base register is unchanged so that the
 * instruction can be restarted, although some words may have been transferred (DDI 0403E, B1.5.9).
 */
/* Return the address of the first word of a transfer, before the transfer is executed. */
uint32_t transfer_address(const struct core *core, const struct instruction *instruction);

/* LDM and POP; if the PC is in the list, *target is its loaded value. */
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
