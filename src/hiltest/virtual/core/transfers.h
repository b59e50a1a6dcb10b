/* Instructions that transfer several words, or under the exclusive monitor.
 *
 * Each returns false if it faults: core.fault is set then and no base register has been written back, though some words
 * may have been transferred (DDI 0403E, B1.5.9: the base is restored, so that the instruction can be restarted).
 */
#ifndef HILTEST_TRANSFERS_H
#define HILTEST_TRANSFERS_H

#include "state.h"

/* Address of the first word of a transfer that has `words` of them, before it is executed. */
uint32_t transfer_address(const struct core *core, const struct instruction *instruction);

/* LDM and POP; *target is what the PC was loaded with, if it is in the list. */
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
