/** @file start_up.c @brief From reset to main(), and the vector table. */
#include "boards/board.h"
#include "registers.h"

extern uint32_t data_start[], data_end[], bss_start[], bss_end[];
extern const uint32_t data_load[];
extern uint32_t stack_top[];

int main(void);
_Noreturn void Reset_Handler(void);
void Fault_Handler(void);
void SysTick_Handler(void);
void EXTI2_Handler(void);
void DMA1_Stream6_Handler(void);
void TIM2_Handler(void);
void I2C1_Event_Handler(void);
void I2C1_Error_Handler(void);
void USART2_Handler(void);

_Noreturn void Reset_Handler(void)
{
    SCB_CPACR |= SCB_CPACR_FPU_FULL_ACCESS; /* no floating-point instruction may come before */
    __asm volatile("dsb\n\tisb" ::: "memory");
    const uint32_t *from = data_load;
    for (uint32_t *to = data_start; to < data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = bss_start; to < bss_end;) {
        *to++ = 0u;
    }
    (void)main();
    board_reset();
}

/** A board on a bench must not need a hand on its reset button: a debugger stops here, otherwise the chip starts again. */
void Fault_Handler(void)
{
    board_reset();
}

typedef void (*vector_t)(void);

/** Entries not named here are unexpected: they end in the fault handler, never in silence. */
__attribute__((section(".vectors"), used)) static const struct {
    const uint32_t *initial_stack;
    vector_t system[15];
    vector_t interrupts[IRQ_COUNT];
} vector_table = {
    .initial_stack = stack_top,
    .system =
        {
            [0] = Reset_Handler,
            [1 ... 13] = Fault_Handler,
            [14] = SysTick_Handler,
        },
    .interrupts =
        {
            [0 ... IRQ_EXTI2 - 1] = Fault_Handler,
            [IRQ_EXTI2] = EXTI2_Handler,
            [IRQ_EXTI2 + 1 ... IRQ_DMA1_STREAM6 - 1] = Fault_Handler,
            [IRQ_DMA1_STREAM6] = DMA1_Stream6_Handler,
            [IRQ_DMA1_STREAM6 + 1 ... IRQ_TIM2 - 1] = Fault_Handler,
            [IRQ_TIM2] = TIM2_Handler,
            [IRQ_TIM2 + 1 ... IRQ_I2C1_EVENT - 1] = Fault_Handler,
            [IRQ_I2C1_EVENT] = I2C1_Event_Handler,
            [IRQ_I2C1_ERROR] = I2C1_Error_Handler,
            [IRQ_I2C1_ERROR + 1 ... IRQ_USART2 - 1] = Fault_Handler,
            [IRQ_USART2] = USART2_Handler,
            [IRQ_USART2 + 1 ... IRQ_COUNT - 1] = Fault_Handler,
        },
};
