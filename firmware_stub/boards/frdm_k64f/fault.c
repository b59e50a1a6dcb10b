/**
 * @file fault.c
 * @brief Record a fault, then stop for a debugger or start again.
 *
 * A board on a bench must not need a hand on its reset button: without a debugger the chip resets, the host sees the link come
 * back with a new SYNC, and the command that died has no answer.
 */
#include "fault.h"

#include "boards/board.h"
#include "registers.h"

static fault_record_t fault_record __attribute__((section(".noinit"), used));

_Noreturn void board_reset(void)
{
    __asm volatile("dsb" ::: "memory");
    SCB_AIRCR = SCB_AIRCR_SYSRESETREQ;
    __asm volatile("dsb" ::: "memory");
    for (;;) {
        __asm volatile("wfi"); /* the reset takes a few cycles */
    }
}

_Noreturn static void stop_or_reset(void)
{
    if ((DHCSR & DHCSR_DEBUGGER) != 0u) {
        __asm volatile("bkpt #0");
    }
    board_reset();
}

_Noreturn void fault_reset(fault_cause_t cause)
{
    fault_record = (fault_record_t){.marker = FAULT_MARKER, .cause = cause};
    stop_or_reset();
}

_Noreturn void fault_from_exception(const uint32_t *stacked);

_Noreturn void fault_from_exception(const uint32_t *stacked)
{
    uint32_t exception;
    __asm volatile("mrs %0, ipsr" : "=r"(exception));
    fault_record.marker = FAULT_MARKER;
    fault_record.cause = FAULT_EXCEPTION;
    fault_record.exception = exception;
    for (uint32_t i = 0; i < 8u; i++) {
        fault_record.frame[i] = stacked[i];
    }
    fault_record.cfsr = SCB_CFSR;
    fault_record.hfsr = SCB_HFSR;
    fault_record.bfar = SCB_BFAR;
    stop_or_reset();
}

/* Naked: the compiler's own prologue would move the stack pointer away from the stacked registers. */
__attribute__((naked)) void Fault_Handler(void)
{
    __asm volatile("mrs r0, msp\n\t"
                   "b fault_from_exception");
}
