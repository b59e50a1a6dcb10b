/* Bits of the special registers, and the selection of the stack pointer in r13. References are to DDI 0403E. */
#ifndef HILTEST_REGISTERS_H
#define HILTEST_REGISTERS_H

#include "state.h"

enum {
    CONTROL_NPRIV = 1 << 0, CONTROL_SPSEL = 1 << 1, CONTROL_FPCA = 1 << 2, /* B1.4.4 */
    XPSR_EXCEPTION = 0x1FF, XPSR_REALIGNED = 1 << 9, XPSR_THUMB = 1 << 24, /* B1.4.2; bit 9 is in frames only */
};

/* FPCCR (B3.2.21), and the modes of FPSCR that FPDSCR gives a new context: AHP, DN, FZ, RMode. */
#define FPCCR_ASPEN (1u << 31)
#define FPCCR_LSPEN (1u << 30)
#define FPDSCR_BITS 0x07C00000u

/* Handler mode always uses the main stack (B1.4.1). */
static inline bool uses_process_stack(const struct core *core)
{
    return core->exception == EXCEPTION_NONE && (core->control & CONTROL_SPSEL) != 0;
}

/* Set IPSR and CONTROL, and switch r13 to the stack pointer that they select. */
void set_mode(struct core *core, uint32_t exception, uint32_t control);

#endif
