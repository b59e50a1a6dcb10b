/* Special registers and masks, as MRS, MSR and CPS reach them (DDI 0403E, B5.2). */
#ifndef HILTEST_SYSTEM_H
#define HILTEST_SYSTEM_H

#include "state.h"

uint32_t read_special(struct machine *machine, uint32_t number);
/* `mask` bit 1 writes the flags of APSR, bit 0 GE. */
void write_special(struct machine *machine, uint32_t number, uint32_t mask, uint32_t value);
void change_masks(struct machine *machine, const struct instruction *instruction);

#endif
