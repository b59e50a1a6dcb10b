/**
 * @file fault.h
 * @brief The handler of faults.
 */
#ifndef HILTEST_FAULT_H
#define HILTEST_FAULT_H

#include <stdint.h>

typedef enum {
    FAULT_NONE = 0,
    FAULT_EXCEPTION = 1,     /**< hard fault or an interrupt that was not enabled */
    FAULT_MAIN_RETURNED = 2, /**< main() must not end */
    FAULT_CLOCK = 3,         /**< the oscillator or the PLL did not come up */
} fault_cause_t;

/** The last fault; kept over the reset that follows it, for a debugger to read. Valid when `marker` is FAULT_MARKER. */
typedef struct {
    uint32_t marker;
    fault_cause_t cause;
    uint32_t exception; /**< IPSR: 3 hard fault, 16 + n interrupt n */
    uint32_t frame[8];  /**< r0, r1, r2, r3, r12, lr, pc, xpsr as stacked */
    uint32_t cfsr, hfsr, bfar;
} fault_record_t;

#define FAULT_MARKER 0x4C544146u

/** Entry of every exception that is not expected. */
void Fault_Handler(void);

/** Record why, stop in the debugger when one is attached, otherwise reset the chip. */
_Noreturn void fault_reset(fault_cause_t cause);

#endif
