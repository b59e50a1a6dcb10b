/**
 * @file cycle_counter.c
 * @brief The DWT cycle counter. In fast code: measured code calls it, and a call into flash would add what the flash adds.
 */
#include "boards/cycle_counter.h"

#include "calibration/fast_code.h"
#include "interrupt_mask.h"
#include "registers.h"

bool cycle_counter_start(void)
{
    DEMCR |= DEMCR_TRCENA; /* without it the DWT does not answer */
    if ((DWT_CTRL & DWT_CTRL_NOCYCCNT) != 0u) {
        return false;
    }
    DWT_CYCCNT = 0u;
    DWT_CTRL |= DWT_CTRL_CYCCNTENA;
    return true;
}

FAST_CODE uint32_t cycle_counter_read(void)
{
    return DWT_CYCCNT;
}

FAST_CODE uint32_t interrupts_mask(void)
{
    return primask_set();
}

FAST_CODE void interrupts_restore(uint32_t mask)
{
    primask_restore(mask);
}
