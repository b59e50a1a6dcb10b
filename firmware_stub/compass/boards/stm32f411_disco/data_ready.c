/** @file data_ready.c @brief The magnetometer's data-ready pin on PE2, whose rising edge interrupts a wait (EXTI2). */
#include "data_ready.h"

#include "board_parts.h"
#include "boards/time_base.h"
#include "registers.h"

#define PIN 2u

void EXTI2_Handler(void);

void data_ready_start(void)
{
    SYSCFG_EXTICR1 = SYSCFG_EXTICR1_EXTI2_PE;
    EXTI_RTSR = 1u << PIN;
    EXTI_PR = 1u << PIN;
    EXTI_IMR = 1u << PIN;
    interrupt_enable(IRQ_EXTI2);
}

void EXTI2_Handler(void)
{
    EXTI_PR = 1u << PIN;
    wait_is_over();
}

/** The level, and not the edge, counts: a sample that was ready before the wait began has no edge any more. */
static bool is_high(const void *context)
{
    (void)context;
    return (GPIO_IDR(GPIOE_BASE) & 1u << PIN) != 0u;
}

bool data_ready_wait(uint32_t timeout_us)
{
    return wait_briefly(is_high, (const void *)0, timeout_us);
}
