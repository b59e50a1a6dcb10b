/**
 * @file board.h
 * @brief What every board provides besides its UART, I2C buses, time base and cycle counter.
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

/** Reset the whole chip. Does not return. */
_Noreturn void board_reset(void);

#endif
