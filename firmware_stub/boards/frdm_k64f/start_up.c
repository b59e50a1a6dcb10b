/**
 * @file start_up.c
 * @brief From reset to main(), the vector table and the flash configuration field.
 */
#include "fault.h"
#include "registers.h"

extern uint32_t fast_code_start[], fast_code_end[], data_start[], data_end[], bss_start[], bss_end[];
extern const uint32_t fast_code_load[], data_load[];
extern uint32_t stack_top[];

int main(void);
_Noreturn void Reset_Handler(void);
void SVC_Handler(void);
void SysTick_Handler(void);
void I2C0_Handler(void);
void I2C1_Handler(void);
void UART0_Handler(void);

/** The chip reads these 16 bytes before the first instruction: no backdoor key, nothing protected, not secured (FSEC = 0xFE). */
__attribute__((section(".flash_config"), used)) static const uint32_t flash_configuration[4] = {
    0xFFFFFFFFu, 0xFFFFFFFFu, 0xFFFFFFFFu, 0xFFFFFFFEu,
};

/** Stop the watchdog. It must be unlocked and configured within 256 bus cycles after reset. */
static inline void watchdog_stop(void)
{
    WDOG_UNLOCK = 0xC520u;
    WDOG_UNLOCK = 0xD928u;
    WDOG_STCTRLH = 0x01D2u; /* WAITEN, STOPEN, ALLOWUPDATE, CLKSRC as after reset; WDOGEN = 0 */
}

/** Let code use the FPU. Nothing before this may contain a floating-point instruction. */
static inline void fpu_enable(void)
{
    SCB_CPACR |= SCB_CPACR_FPU_FULL_ACCESS;
    __asm volatile("dsb\n\tisb" ::: "memory");
}

/* Both take eight words at a time: most of a start is this. */
static void copy_words(uint32_t *to, const uint32_t *end, const uint32_t *from)
{
    for (; end - to >= 8; to += 8, from += 8) {
#pragma GCC unroll 8
        for (int i = 0; i < 8; i++) {
            to[i] = from[i];
        }
    }
    while (to < end) {
        *to++ = *from++;
    }
}

static void clear_words(uint32_t *to, const uint32_t *end)
{
    for (; end - to >= 8; to += 8) {
#pragma GCC unroll 8
        for (int i = 0; i < 8; i++) {
            to[i] = 0u;
        }
    }
    while (to < end) {
        *to++ = 0u;
    }
}

_Noreturn void Reset_Handler(void)
{
    watchdog_stop();
    fpu_enable();
    copy_words(fast_code_start, fast_code_end, fast_code_load);
    copy_words(data_start, data_end, data_load);
    clear_words(bss_start, bss_end);
    __asm volatile("dsb\n\tisb" ::: "memory"); /* the copied code is code from here on */
    main();
    fault_reset(FAULT_MAIN_RETURNED);
}

typedef void (*vector_t)(void);

/** Entries not named here are unexpected: they end in the fault handler, never in silence. */
__attribute__((section(".vectors"), used)) static const struct {
    const uint32_t *initial_stack;
    vector_t system[15];
    vector_t interrupts[86];
} vector_table = {
    .initial_stack = stack_top,
    .system =
        {
            [0] = Reset_Handler,
            [1 ... 9] = Fault_Handler,
            [10] = SVC_Handler,
            [11 ... 13] = Fault_Handler,
            [14] = SysTick_Handler,
        },
    .interrupts =
        {
            [0 ... IRQ_I2C0 - 1] = Fault_Handler,
            [IRQ_I2C0] = I2C0_Handler,
            [IRQ_I2C1] = I2C1_Handler,
            [IRQ_I2C1 + 1 ... IRQ_UART0_STATUS - 1] = Fault_Handler,
            [IRQ_UART0_STATUS] = UART0_Handler,
            [IRQ_UART0_ERROR] = UART0_Handler,
            [IRQ_UART0_ERROR + 1 ... 85] = Fault_Handler,
        },
};
