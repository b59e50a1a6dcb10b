/*
 * Functions whose calls are watched, each with the same work for the same argument, while interrupts flood them:
 * SysTick, and a timer that is more urgent and interrupts its handler.
 */
#include <stdint.h>

#define APART __attribute__((noinline, noclone))

volatile uint32_t ticks, timeouts, rounds;
volatile float kept;
volatile uint32_t sum;
static uint32_t table[64];

APART uint32_t handled(uint32_t n)
{
    return n * 3u + table[n & 63u];
}

void SysTick_Handler(void)
{
    ticks += handled(ticks) | 1u;
    for (volatile uint32_t i = 0; i < 3u; i++) {
    }
}

void Interrupt48_Handler(void) /* PIT0 */
{
    WORD(0x4003710Cu) = 1u;
    kept = kept * 1.5f; /* uses the FPU, so that state is saved lazily */
    timeouts++;
}

/* Loads behind loads, across the end of a page: what a pipeline that was emptied costs most. */
#define EIGHT(from) \
    "ldr r1, [r0, #" #from "]\n ldr r2, [r0, #" #from " + 4]\n ldr r3, [r0, #" #from " + 8]\n" \
    "add r1, r2\n ldr r2, [r0]\n ldr r1, [r0, #4]\n ldr r3, [r0, #8]\n str r3, [r0, #12]\n"
#define MANY EIGHT(0) EIGHT(4) EIGHT(8) EIGHT(16) EIGHT(20) EIGHT(24) EIGHT(28) EIGHT(32)
__attribute__((naked, noinline, aligned(4096))) void before_straight(void)
{
    __asm volatile(".space 4096 - 600");
}
__attribute__((naked, noinline)) uint32_t straight(uint32_t n)
{
    __asm volatile("ldr r0, =table\n" MANY MANY MANY MANY MANY MANY MANY MANY "bx lr\n .ltorg");
}

/* Every block ends where interrupts are masked or not, without a jump. */
__attribute__((naked, noinline)) uint32_t masked(uint32_t n)
{
    __asm volatile("ldr r0, =table\n"
                   ".rept 40\n ldr r1, [r0]\n cpsie i\n ldr r2, [r0, #4]\n ldr r3, [r0, #8]\n"
                   "vmov s0, r3\n vcvt.f32.u32 s0, s0\n vdiv.f32 s1, s0, s0\n cpsie i\n add r2, r3\n"
                   "vadd.f32 s2, s1, s1\n cpsie i\n vadd.f32 s3, s2, s2\n .endr\n"
                   "bx lr\n .ltorg");
}

APART uint32_t integers(uint32_t n)
{
    uint32_t crc = n;
    for (uint32_t i = 0; i < 40u + n; i++) {
        crc = (crc >> 1) ^ (0xEDB88320u & -(crc & 1u)) ^ table[i & 63u];
        table[(i + n) & 63u] = i;
    }
    return crc / (n + 1u);
}

APART float floats(float x, uint32_t n)
{
    float term = x;
    float total = 0.0f;
    for (uint32_t i = 1; i < 30u + n; i++) {
        total += term;
        term = term * x / (float)i;
    }
    return total;
}

APART uint32_t levels(uint32_t n)
{
    return n == 0u ? integers(3u) : levels(n - 1u) + 1u;
}

int main(void)
{
    WORD(0xE000ED88u) |= 0xFu << 20;  /* the FPU */
    WORD(0xE000ED20u) = 0xC0000000u;  /* SysTick is not urgent */
    WORD(0xE000E014u) = SYSTICK - 1u;
    WORD(0xE000E010u) = 7u;
    WORD(0x4004803Cu) |= 1u << 23; /* the PIT has a clock */
    WORD(0x40037000u) = 0u;
    WORD(0x40037100u) = TIMER;
    WORD(0x40037108u) = 3u;
    WORD(0xE000E104u) = 1u << 16; /* PIT0 */
    for (;;) {
        uint32_t n = rounds % 7u;
        sum += integers(n);
        kept = floats(0.75f, n);
        sum += straight(n);
        sum += masked(n);
        sum += levels(n);
        rounds++;
    }
}
