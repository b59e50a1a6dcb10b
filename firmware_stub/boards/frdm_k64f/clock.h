/**
 * @file clock.h
 * @brief The clocks this board runs at.
 */
#ifndef HILTEST_CLOCK_H
#define HILTEST_CLOCK_H

#include <stdbool.h>

#define CORE_CLOCK_HZ 120000000u
#define BUS_CLOCK_HZ 60000000u

/** From the reset state (FEI, about 21 MHz) to PEE at 120 MHz. False when oscillator or PLL do not answer in time. */
bool clock_start(void);

#endif
