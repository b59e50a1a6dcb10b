/**
 * @file clock.c
 * @brief 100 MHz from the 8 MHz oscillator: 8 MHz / 4 * 200 / 4, APB1 half of it.
 *
 * The order is the one that RM0383 prescribes: regulator while the PLL is off, wait states before the faster clock.
 */
#include "board_parts.h"
#include "registers.h"

/* M = 4: the PLL's input is 2 MHz, as the manual recommends; N = 200, P = 4 (01), clock from HSE, Q = 9 (no USB). */
#define PLL_100_MHZ (4u | 200u << 6 | 1u << 16 | 1u << 22 | 9u << 24)
#define WAIT_STATES 3u /* 90 to 100 MHz at 2.7 to 3.6 V, table 5 */
/* The oscillator starts in 2 ms; a look takes at least 4 cycles of 16 MHz, so this is over 25 ms. */
#define MAXIMUM_LOOKS 100000u

static bool wait_for(volatile const uint32_t *status, uint32_t mask, uint32_t wanted)
{
    for (uint32_t looks = 0; looks < MAXIMUM_LOOKS; looks++) {
        if ((*status & mask) == wanted) {
            return true;
        }
    }
    return false;
}

bool clock_start(void)
{
    RCC_CR |= RCC_CR_HSEON;
    if (!wait_for(&RCC_CR, RCC_CR_HSERDY, RCC_CR_HSERDY)) {
        return false;
    }
    RCC_APB1ENR |= RCC_APB1ENR_PWR;
    PWR_CR |= PWR_CR_VOS_SCALE_1;
    RCC_PLLCFGR = (RCC_PLLCFGR & RCC_PLLCFGR_RESERVED) | PLL_100_MHZ;
    RCC_CR |= RCC_CR_PLLON;
    if (!wait_for(&RCC_CR, RCC_CR_PLLRDY, RCC_CR_PLLRDY) || !wait_for(&PWR_CSR, PWR_CSR_VOSRDY, PWR_CSR_VOSRDY)) {
        return false;
    }
    FLASH_ACR = WAIT_STATES | FLASH_ACR_PRFTEN | FLASH_ACR_ICEN | FLASH_ACR_DCEN;
    if ((FLASH_ACR & FLASH_ACR_LATENCY) != WAIT_STATES) {
        return false;
    }
    RCC_CFGR = RCC_CFGR_PPRE1_DIV2 | RCC_CFGR_SW_PLL;
    return wait_for(&RCC_CFGR, RCC_CFGR_SWS, RCC_CFGR_SWS_PLL);
}
