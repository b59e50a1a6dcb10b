/**
 * @file board_parts.h
 * @brief Start-up of this board's parts; called by board_start() only.
 */
#ifndef HILTEST_BOARD_PARTS_H
#define HILTEST_BOARD_PARTS_H

void time_base_start(void);
void uart_start(void);
void i2c_start(void);

#endif
