/**
 * @file time_base.c
 * @brief Time from three chained PIT channels, waking up by SysTick.
 *
 * Channel 0 divides the bus clock down to microseconds, channel 1 counts these down from 2^32 - 1 and channel 2 its wraps: 64 bits
 * that nothing divides. This chip's PIT has no lifetime registers that would read both words at once, so the high one is read behind the
 * low one, and before it too where the low one may have wrapped meanwhile.
 */
#include "boards/time_base.h"

#include "board_parts.h"
#include "clock.h"
#include "interrupt_mask.h"
#include "registers.h"

#define BUS_CLOCKS_PER_US (BUS_CLOCK_HZ / 1000000u)
#define CORE_CLOCKS_PER_US (CORE_CLOCK_HZ / 1000000u)

_Static_assert(WAIT_BRIEFLY_MAXIMUM_US * CORE_CLOCKS_PER_US <= 0x1000000u, "SysTick has 24 bits");

/* No interrupt keeps two reads apart for so long. */
#define NEAR_WRAP_US 1000000u

static volatile bool tick_came;

void SysTick_Handler(void);

void SysTick_Handler(void)
{
    SYST_CSR = 0u; /* one shot */
    wait_is_over();
    tick_came = true;
}

void time_base_start(void)
{
    SIM_SCGC6 |= SIM_SCGC6_PIT;
    (void)PIT_MCR; /* a write within two bus clocks after the gate opens is lost (erratum e7914); this read takes as long */
    PIT_MCR = 0u;
    for (uint32_t word = 2u; word > 0u; word--) {
        PIT_LDVAL(word) = 0xFFFFFFFFu;
        PIT_TCTRL(word) = PIT_TCTRL_CHAIN | PIT_TCTRL_ENABLE;
    }
    PIT_LDVAL(0u) = BUS_CLOCKS_PER_US - 1u;
    PIT_TCTRL(0u) = PIT_TCTRL_ENABLE;
}

uint64_t time_us(void)
{
    uint32_t low = PIT_CVAL(1u);
    uint32_t high = PIT_CVAL(2u);
    if (low < NEAR_WRAP_US) {
        low = PIT_CVAL(1u);
        const uint32_t high_after = PIT_CVAL(2u);
        if (high != high_after) { /* it wrapped, before or behind this read of the low word; it will not again for 71 minutes */
            high = high_after;
            low = PIT_CVAL(1u);
        }
    }
    return ~(((uint64_t)high << 32) | low); /* both count down */
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
    if (!tick_came) { /* which stops it itself */
        SYST_CSR = 0u;
    }
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
    uint64_t now_us = holds ? 0u : time_us();
    while (!holds && now_us < deadline_us) {
        const uint64_t left_us = deadline_us - now_us;
        if (left_us <= WAIT_BRIEFLY_MAXIMUM_US) { /* SysTick counts the same clock from later on: the deadline is not before it */
            return wait_briefly(done, context, (uint32_t)left_us);
        }
        holds = wait_briefly(done, context, WAIT_BRIEFLY_MAXIMUM_US);
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
