/** @file board.c @brief Bring up the STM32F411 Discovery (MB1115), start it again after a fault. */
#include "boards/board.h"

#include "board_parts.h"
#include "registers.h"

const board_description_t board = {
    .name = "compass-stm32f411",
    .placement = "flash",
    .core_clock_hz = CORE_CLOCK_HZ,
};

void board_start(void)
{
    if (!clock_start()) {
        board_reset(); /* without its clock the USART has no baud rate to complain at; starting again may help */
    }
    RCC_AHB1ENR |= RCC_AHB1ENR_GPIOA | RCC_AHB1ENR_GPIOB | RCC_AHB1ENR_GPIOE | RCC_AHB1ENR_DMA1;
    RCC_APB1ENR |= RCC_APB1ENR_TIM2 | RCC_APB1ENR_USART2 | RCC_APB1ENR_I2C1;
    RCC_APB2ENR |= RCC_APB2ENR_SPI1 | RCC_APB2ENR_SYSCFG;
    (void)RCC_APB2ENR; /* a block may be used two of its clocks after its enable bit was set (errata); a read takes as long */
    time_base_start();
    uart_start();
    i2c_start();
    spi_start();
    data_ready_start();
}

_Noreturn void board_reset(void)
{
    if ((DHCSR & DHCSR_DEBUGGER) != 0u) {
        __asm volatile("bkpt #0");
    }
    __asm volatile("dsb" ::: "memory");
    SCB_AIRCR = SCB_AIRCR_SYSRESETREQ;
    __asm volatile("dsb" ::: "memory");
    for (;;) {
        __asm volatile("wfi"); /* the reset takes a few cycles */
    }
}
