/**
 * @file board.c
 * @brief Bring up the FRDM-K64F.
 */
#include "boards/board.h"

#include "board_parts.h"
#include "clock.h"
#include "fault.h"
#include "registers.h"

const board_description_t board = {
    .name = "hiltest-frdm-k64f",
    .placement = "sram",
    .core_clock_hz = CORE_CLOCK_HZ,
};

void board_start(void)
{
    if (!clock_start()) {
        fault_reset(FAULT_CLOCK); /* without its clock the UART has no baud rate to complain at; starting again may help */
    }
    SIM_SCGC5 |= SIM_SCGC5_PORTB | SIM_SCGC5_PORTC | SIM_SCGC5_PORTE;
    time_base_start();
    uart_start();
    i2c_start();
}
