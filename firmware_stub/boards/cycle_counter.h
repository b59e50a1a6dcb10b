/**
 * @file cycle_counter.h
 * @brief Core clock cycles of a piece of code, and keeping interrupts out of it.
 */
#ifndef HILTEST_CYCLE_COUNTER_H
#define HILTEST_CYCLE_COUNTER_H

#include <stdbool.h>
#include <stdint.h>

/** Start the counter. False when this core has none: readings would all be 0 and must not be used. */
bool cycle_counter_start(void);

/** Cycles modulo 2^32. */
uint32_t cycle_counter_read(void);

/** Mask interrupts; returns what interrupts_restore() needs. */
uint32_t interrupts_mask(void);

/** Undo interrupts_mask(). */
void interrupts_restore(uint32_t mask);

#endif
