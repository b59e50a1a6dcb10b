/**
 * @file clock.c
 * @brief 120 MHz from the 50 MHz that the Ethernet PHY puts on EXTAL0.
 *
 * FEI -> FBE -> PBE -> PEE, the order the reference manual prescribes. 50 MHz / 15 * 36 = 120 MHz.
 */
#include "clock.h"

#include <stdint.h>

#include "registers.h"

/* Dividers for core 120, bus 60, FlexBus 40 and flash 24 MHz; safe at the slow clock too. */
#define CLKDIV1_120_60_40_24 0x01240000u
/* The longest step is the lock of the PLL, about 0.5 ms; a look takes at least 4 cycles of 21 MHz, so this is over 10 ms. */
#define MAXIMUM_LOOKS 60000u

#define C2_VERY_HIGH_RANGE_EXTERNAL 0x20u /* RANGE = 2; EREFS = 0: a clock is fed in, no crystal */
#define C1_EXTERNAL_FRDIV 0xB8u           /* CLKS = 2 (external), FRDIV = 7 (/1536: 32.6 kHz, in the FLL's range), IREFS = 0 */
#define C1_PLL_FRDIV 0x38u                /* CLKS = 0 (PLL, because C6.PLLS is set) */
#define C5_DIVIDE_15 0x0Eu
#define C6_PLL_TIMES_36 0x4Cu /* PLLS, VDIV0 = 12 */

static bool wait_for_status(uint8_t mask, uint8_t wanted)
{
    for (uint32_t looks = 0; looks < MAXIMUM_LOOKS; looks++) {
        if ((MCG_S & mask) == wanted) {
            return true;
        }
    }
    return false;
}

bool clock_start(void)
{
    SIM_CLKDIV1 = CLKDIV1_120_60_40_24;

    MCG_C2 = C2_VERY_HIGH_RANGE_EXTERNAL;
    MCG_C1 = C1_EXTERNAL_FRDIV;
    if (!wait_for_status(MCG_S_IREFST | MCG_S_CLKST, 0x08u)) { /* external reference, core on the external clock: FBE */
        return false;
    }

    MCG_C5 = C5_DIVIDE_15;
    MCG_C6 = C6_PLL_TIMES_36;
    if (!wait_for_status(MCG_S_PLLST | MCG_S_LOCK0, MCG_S_PLLST | MCG_S_LOCK0)) { /* PBE */
        return false;
    }

    MCG_C1 = C1_PLL_FRDIV;
    return wait_for_status(MCG_S_CLKST, MCG_S_CLKST); /* core on the PLL: PEE */
}
