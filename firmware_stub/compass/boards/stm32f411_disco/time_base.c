/**
 * @file time_base.c
 * @brief Time from TIM2, which counts microseconds in 32 bits, with its wraps counted; waking up by SysTick.
 *
 * Waiting is that of the FRDM-K64F: WFI with interrupts masked, and handlers that return into sleep until wait_is_over().
 */
#include "boards/time_base.h"

#include "board_parts.h"
#include "registers.h"

#define CORE_CLOCKS_PER_US (CORE_CLOCK_HZ / 1000000u) /* the timers of APB1 run at twice its clock, which is the core's */
#define HALF_A_TURN 0x80000000u

_Static_assert(WAIT_BRIEFLY_MAXIMUM_US * CORE_CLOCKS_PER_US <= 0x1000000u, "SysTick has 24 bits");

static volatile bool tick_came;
static volatile uint32_t wraps;

void SysTick_Handler(void);
void TIM2_Handler(void);

void SysTick_Handler(void)
{
    SYST_CSR = 0u; /* one shot */
    wait_is_over();
    tick_came = true;
}

void TIM2_Handler(void)
{
    TIM2_SR = ~TIM2_SR_UIF;
    wraps++;
}

void time_base_start(void)
{
    TIM2_PSC = CORE_CLOCKS_PER_US - 1u;
    TIM2_ARR = 0xFFFFFFFFu;
    TIM2_EGR = TIM2_EGR_UG; /* loads the prescaler, and sets the flag of a wrap that was none */
    TIM2_SR = ~TIM2_SR_UIF;
    TIM2_DIER = TIM2_DIER_UIE;
    TIM2_CR1 = TIM2_CR1_CEN;
    interrupt_enable(IRQ_TIM2);
}

uint64_t time_us(void)
{
    const uint32_t mask = primask_set();
    const uint32_t low = TIM2_CNT;
    const bool is_wrap_pending = (TIM2_SR & TIM2_SR_UIF) != 0u && low < HALF_A_TURN;
    const uint32_t high = wraps + is_wrap_pending;
    primask_restore(mask);
    return (uint64_t)high << 32 | low;
}

/** Make SysTick fire once, `delay_us` from now; 1 to WAIT_BRIEFLY_MAXIMUM_US. It is off between waits. */
static void start_tick(uint32_t delay_us)
{
    tick_came = false;
    SYST_RVR = delay_us * CORE_CLOCKS_PER_US - 1u;
    SYST_CVR = 0u; /* any write reloads */
    SYST_CSR = SYST_CSR_ENABLE | SYST_CSR_TICKINT | SYST_CSR_CORE_CLOCK;
}

/** Sleep until the condition holds (true) or the tick has come (false). */
static bool wait_for_condition_or_tick(bool (*done)(const void *context), const void *context)
{
    const uint32_t mask = primask_set();
    bool holds = done(context);
    while (!holds && !tick_came) {
        SCB_SCR = SCB_SCR_SLEEPONEXIT; /* only now: a handler that made it true before would have found nothing to take back */
        __asm volatile("dsb\n\twfi" ::: "memory"); /* a pending interrupt ends it though it is masked */
        primask_restore(mask);
        __asm volatile("isb" ::: "memory"); /* what woke the core runs here */
        (void)primask_set();
        holds = done(context);
    }
    primask_restore(mask);
    return holds;
}

bool wait_briefly(bool (*done)(const void *context), const void *context, uint32_t timeout_us)
{
    start_tick(timeout_us);
    const bool holds = wait_for_condition_or_tick(done, context);
    SYST_CSR = 0u;
    return holds;
}

void wait_is_over(void)
{
    SCB_SCR = 0u;
    __asm volatile("dsb" ::: "memory"); /* before the handler returns */
}

bool wait_until(bool (*done)(const void *context), const void *context, uint64_t deadline_us)
{
    if (deadline_us == WAIT_FOREVER) {
        tick_came = false; /* and none will come */
        return wait_for_condition_or_tick(done, context);
    }
    bool holds = done(context);
    uint64_t now_us = time_us();
    while (!holds && now_us < deadline_us) {
        const uint64_t left_us = deadline_us - now_us;
        holds = wait_briefly(done, context, left_us < WAIT_BRIEFLY_MAXIMUM_US ? (uint32_t)left_us : WAIT_BRIEFLY_MAXIMUM_US);
        now_us = time_us();
    }
    return holds;
}

static bool never(const void *context)
{
    (void)context;
    return false;
}

void sleep_until_us(uint64_t deadline_us)
{
    (void)wait_until(never, (const void *)0, deadline_us);
}
