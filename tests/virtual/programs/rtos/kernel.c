#include "kernel.h"

#include "registers.h"

enum { TASKS = 2, STACK_WORDS = 256, FRAME_WORDS = 8, SAVED_WORDS = 9 };
enum { CALL_START = 0, CALL_TICKS = 1, CALL_YIELD = 2 };

/* context.S: leaves the handler into the first task */
_Noreturn void context_start(uint32_t *stack);
uint32_t *kernel_switch(uint32_t *stack);
void kernel_call(uint32_t *frame);

static uint32_t stacks[TASKS][STACK_WORDS] __attribute__((aligned(8)));
static uint32_t *saved[TASKS];
static uint32_t current;
static volatile uint32_t ticks;
volatile uint32_t preempted_timer; /* ticks that came while the timer's handler ran */
extern volatile uint32_t timer_runs;

static uint32_t *prepare(uint32_t *stack_end, void (*task)(void))
{
    uint32_t *frame = stack_end - FRAME_WORDS;
    uint32_t *stack = frame - SAVED_WORDS;

    for (uint32_t word = 0; word < SAVED_WORDS + FRAME_WORDS; word++) {
        stack[word] = 0u;
    }
    stack[SAVED_WORDS - 1] = 0xFFFFFFFDu;      /* EXC_RETURN: thread mode, PSP, no floating-point state yet */
    frame[6] = (uint32_t)(uintptr_t)task & ~1u;
    frame[7] = 1u << 24;
    return stack;
}

_Noreturn void kernel_start(void (*first)(void), void (*second)(void))
{
    saved[0] = prepare(stacks[0] + STACK_WORDS, first);
    saved[1] = prepare(stacks[1] + STACK_WORDS, second);
    SYSTEM_PRIORITY(EXCEPTION_PENDSV) = 0xF0u;
    SYSTEM_PRIORITY(EXCEPTION_SVCALL) = 0xE0u;
    SYSTEM_PRIORITY(EXCEPTION_SYSTICK) = TICK_PRIORITY;
    SYST_RVR = 120000u - 1u; /* 1 ms */
    SYST_CVR = 0u;
    SYST_CSR = 7u;
    __asm volatile("svc #0");
    for (;;) {
    }
}

uint32_t kernel_ticks(void)
{
    register uint32_t answer __asm("r0");

    __asm volatile("svc #1" : "=r"(answer)::"memory");
    return answer;
}

void kernel_yield(void)
{
    __asm volatile("svc #2" ::: "memory");
}

/* Called by SVC_Handler with the caller's stacked registers. */
void kernel_call(uint32_t *frame)
{
    const uint8_t number = ((const uint8_t *)(uintptr_t)frame[6])[-2];

    switch (number) {
    case CALL_START:
        context_start(saved[0]);
    case CALL_TICKS:
        frame[0] = ticks;
        break;
    case CALL_YIELD:
        ICSR = 1u << 28;
        break;
    default:
        break;
    }
}

/* Called by PendSV_Handler: takes the stack of the task that ran, returns that of the next. */
uint32_t *kernel_switch(uint32_t *stack)
{
    saved[current] = stack;
    current = (current + 1u) % TASKS;
    return saved[current];
}

void SysTick_Handler(void)
{
    ticks++;
    preempted_timer += timer_runs;
    ICSR = 1u << 28; /* PendSV, when no other handler runs */
}
