/**
 * @file board.h
 * @brief The functions that every board provides besides its UART, I2C buses, time base and cycle counter.
 */
#ifndef HILTEST_BOARD_H
#define HILTEST_BOARD_H

#include <stdint.h>

/** Facts that IDENTITY answers. */
typedef struct {
    const char *name;
    const char *placement;  /**< memory that calibrators run from */
    uint32_t core_clock_hz; /**< after board_start() */
} board_description_t;

extern const board_description_t board;

/** Bring up clocks, pins, time base, UART and I2C. Returns only when all of them run. */
void board_start(void);

/**
 * Tell which chip this is.
 *
 * @param[out] id 128 bits, most significant word first; a virtual board says so here
 */
void board_unique_id(uint32_t id[4]);

/** Reset the whole chip. Does not return. */
_Noreturn void board_reset(void);

#endif
