/** @file board_parts.h @brief Start-up of this board's parts, called by board_start() only, and the clocks it runs at. */
#ifndef COMPASS_STM32F411_BOARD_PARTS_H
#define COMPASS_STM32F411_BOARD_PARTS_H

#include <stdbool.h>

#define CORE_CLOCK_HZ 100000000u
#define APB1_CLOCK_HZ 50000000u

/** From the 16 MHz after reset to 100 MHz. False when the crystal, the PLL or the regulator is not ready in time. */
bool clock_start(void);

void time_base_start(void);
void uart_start(void);
void i2c_start(void);
void spi_start(void);
void data_ready_start(void);

#endif
