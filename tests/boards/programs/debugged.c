/* Work with loops, conditions, floating point, calls, an interrupt and sleep: something to look into. */
#include <stdint.h>

#define CPACR (*(volatile uint32_t *)0xE000ED88)
#define SYST ((volatile uint32_t *)0xE000E010)

volatile uint32_t count, total, last, ticks, beyond;
volatile float ratio;

__attribute__((noinline)) static uint32_t weigh(uint32_t x)
{
    uint32_t y = (x & 1) ? x * 3 : x + 5;

    last = y;
    return y + (y > 20 ? 7 : y < 9 ? 2 : 0);
}

__attribute__((noinline)) uint32_t work(uint32_t n)
{
    uint32_t sum = 0;

    for (uint32_t k = 0; k < n; k++) {
        count++;
        sum += weigh(k);
        ratio = (float)sum / (float)(k + 1);
    }
    total = sum;
    return sum;
}

void SysTick_Handler(void)
{
    ticks++;
}

int main(void)
{
    CPACR |= 0xFu << 20;
    __asm volatile("dsb\n isb");
    SYST[1] = 9999;
    SYST[2] = 0;
    SYST[0] = 7;
    for (;;) {
        work(20);
        if (beyond == 1) {
            __asm volatile("bkpt 0");
            beyond = 0;
        } else if (beyond == 2) {
            SYST[0] = 0;
            __asm volatile("cpsid i\n b .");
        }
        __asm volatile("wfi");
    }
}
