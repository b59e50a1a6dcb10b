/* A kernel with two tasks, switched at every tick and when one yields. An interrupt uses the FPU as the tasks do. */
#include <stdint.h>

#define SYSTEM_PRIORITY(exception) (*(volatile uint8_t *)(0xE000ED14u + (exception)))
#define ICSR WORD(0xE000ED04u)
#ifdef WITHOUT_FLOATING_POINT_CONTEXT
#define SAVE_FLOATS
#define RESTORE_FLOATS
#else
#define SAVE_FLOATS "tst lr, #0x10\n it eq\n vstmdbeq r0!, {s16-s31}\n"
#define RESTORE_FLOATS "tst lr, #0x10\n it eq\n vldmiaeq r0!, {s16-s31}\n"
#endif

enum { TASKS = 2, STACK_WORDS = 256, FRAME_WORDS = 8, SAVED_WORDS = 9, TERMS = 400 };
enum { CALL_START, CALL_TICKS, CALL_YIELD };

static uint32_t stacks[TASKS][STACK_WORDS] __attribute__((aligned(8)));
static uint32_t *saved[TASKS];
static uint32_t current;
static volatile uint32_t ticks, timer_runs;
static volatile float weight = 1.0f;

/* What a test reads; a result that differs from the first one of its task was disturbed. */
volatile uint32_t preempted_timer, timer_rounds, rounds[TASKS], disturbed[TASKS];
volatile float first_result[TASKS];

__attribute__((naked)) void context_start(uint32_t *stack)
{
    __asm volatile("ldmia r0!, {r4-r11, lr}\n msr psp, r0\n bx lr");
}

__attribute__((naked)) void SVC_Handler(void)
{
    __asm volatile("tst lr, #4\n ite eq\n mrseq r0, msp\n mrsne r0, psp\n b kernel_call");
}

__attribute__((naked)) void PendSV_Handler(void)
{
    __asm volatile("mrs r0, psp\n" SAVE_FLOATS "stmdb r0!, {r4-r11, lr}\n bl kernel_switch\n"
                   "ldmia r0!, {r4-r11, lr}\n" RESTORE_FLOATS "msr psp, r0\n bx lr");
}

/* Called by SVC_Handler with the caller's stacked registers. */
void kernel_call(uint32_t *frame)
{
    switch (((const uint8_t *)(uintptr_t)frame[6])[-2]) {
    case CALL_START:
        context_start(saved[0]);
        break;
    case CALL_TICKS:
        frame[0] = ticks;
        break;
    default:
        ICSR = 1u << 28;
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

void Interrupt48_Handler(void) /* PIT0: it runs for a quarter of the time */
{
    WORD(0x4003710Cu) = 1u;
    timer_runs = 1u;
    weight = weight > 1000.0f ? 1.0f : weight * 1.5f + 2.0f;
    for (volatile uint32_t i = 0; i < 60u; i++) {
    }
    timer_runs = 0u;
    timer_rounds++;
}

static float series(float factor)
{
    float sum = 0.0f, term = 1.0f, alternating = 0.0f, again;
    __asm volatile("vmov s16, %0" : : "t"(factor) : "s16"); /* in a register that only the kernel saves */
    for (uint32_t i = 0; i < TERMS; i++) {
        sum += term;
        alternating = term - alternating;
        term *= factor;
    }
    __asm volatile("vmov %0, s16" : "=t"(again));
    return sum + alternating + (again - factor);
}

static void compute(uint32_t task, float factor)
{
    const float result = series(factor);
    if (rounds[task] == 0u) {
        first_result[task] = result;
    } else if (first_result[task] != result) {
        disturbed[task]++;
    }
    rounds[task]++;
}

static void ask_and_compute(void)
{
    register uint32_t answer __asm("r0");
    for (;;) {
        compute(0, 0.999f);
        __asm volatile("svc #1" : "=r"(answer) : : "memory");
    }
}

static void compute_and_yield(void)
{
    for (;;) {
        compute(1, 0.75f);
        __asm volatile("svc #2" : : : "memory");
    }
}

static void prepare(uint32_t task, void (*code)(void))
{
    uint32_t *stack = stacks[task] + STACK_WORDS - FRAME_WORDS - SAVED_WORDS;
    stack[SAVED_WORDS - 1] = 0xFFFFFFFDu; /* EXC_RETURN: thread mode, PSP, no floating-point state yet */
    stack[SAVED_WORDS + 6] = (uint32_t)(uintptr_t)code & ~1u;
    stack[SAVED_WORDS + 7] = 1u << 24;
    saved[task] = stack;
}

int main(void)
{
    WORD(0xE000ED88u) |= 0xFu << 20; /* the FPU */
    __asm volatile("dsb\n isb");
    prepare(0, ask_and_compute);
    prepare(1, compute_and_yield);
    SYSTEM_PRIORITY(14) = 0xF0u; /* PendSV */
    SYSTEM_PRIORITY(11) = 0xE0u; /* SVCall */
    SYSTEM_PRIORITY(15) = TICK_PRIORITY;
    *(volatile uint8_t *)0xE000E430u = TIMER_PRIORITY;
    WORD(0xE000E104u) = 1u << 16; /* PIT0 */
    WORD(0x4004803Cu) |= 1u << 23;
    WORD(0x40037000u) = 0u;
    WORD(0x40037100u) = 2899u;
    WORD(0x40037108u) = 3u;
    WORD(0xE000E014u) = 20971u - 1u; /* 1 ms out of reset */
    WORD(0xE000E018u) = 0u;
    WORD(0xE000E010u) = 7u;
    __asm volatile("svc #0");
    return 0;
}
