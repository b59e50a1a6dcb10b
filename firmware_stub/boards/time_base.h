/**
 * @file time_base.h
 * @brief A clock that never wraps, and waiting that sleeps.
 */
#ifndef HILTEST_TIME_BASE_H
#define HILTEST_TIME_BASE_H

#include <stdbool.h>
#include <stdint.h>

/** A deadline that never comes. */
#define WAIT_FOREVER UINT64_MAX

/** Time since board_start() [us]. Never wraps in the life of a board. */
uint64_t time_us(void);

/**
 * Sleep until a condition holds or a deadline passes.
 *
 * The core stops (WFI) between looks at the condition. Handlers return into sleep, and not here, until one of them calls
 * wait_is_over(): of many interrupts mostly the last alone concerns who waits. The look and the decision to stop happen with
 * interrupts masked, so an interrupt that makes the condition true in between is not slept over.
 *
 * @param done condition, made true by handlers that call wait_is_over(); called with interrupts masked, must be short
 * @param context handed to `done`
 * @param deadline_us point in time [us], or WAIT_FOREVER
 * @return true when the condition holds, false when the deadline passed first
 */
bool wait_until(bool (*done)(const void *context), const void *context, uint64_t deadline_us);

/** Longest timeout of wait_briefly() [us]. */
#define WAIT_BRIEFLY_MAXIMUM_US 100000u

/** The same with a short timeout from now [us], 1 to WAIT_BRIEFLY_MAXIMUM_US: it does without reading the clock. */
bool wait_briefly(bool (*done)(const void *context), const void *context, uint32_t timeout_us);

/** Called by a handler that has made true what a `wait` may be for; harmless when none is, or for something else. */
void wait_is_over(void);

/** Sleep until a point in time [us]; returns at once when it has passed. */
void sleep_until_us(uint64_t deadline_us);

#endif
