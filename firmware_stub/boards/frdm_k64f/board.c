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

void board_unique_id(uint32_t id[4])
{
    id[0] = SIM_UIDH;
    id[1] = SIM_UIDMH;
    id[2] = SIM_UIDML;
    id[3] = SIM_UIDL;
}

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
