/* Two pulse widths at 24 kHz on pins, while the processor sleeps. -DCOUNTS: it counts in a loop instead; -DINTERRUPTS:
 * each overflow interrupts. */
#include <stdint.h>

#define FTM0(offset) WORD(0x40038000u + (offset))
enum { SC = 0x0, MOD = 0x8, C0SC = 0xC, C0V = 0x10, C1SC = 0x14, C1V = 0x18, TOF = 0x80, TOIE = 0x40, BUS_CLOCK = 0x8 };
enum { HIGH_PULSES = 0x28, ROUND = 874 }; /* of the 20.97 MHz that the bus has out of reset */

volatile uint32_t overflows, turns;

void Interrupt42_Handler(void)
{
    FTM0(SC) &= ~(uint32_t)TOF;
    overflows++;
}

int main(void)
{
    stop_watchdog();
    WORD(0x4004803Cu) |= 1u << 24;              /* FTM0 */
    WORD(0x40048038u) |= 1u << 11;              /* PORTC */
    WORD(0x4004B004u) = 4u << 8;                /* PTC1 and PTC2: FTM0_CH0 and FTM0_CH1 */
    WORD(0x4004B008u) = 4u << 8;
    WORD(0xE000E104u) = 1u << (42 - 32);
    FTM0(MOD) = ROUND - 1;
    FTM0(C0SC) = FTM0(C1SC) = HIGH_PULSES;
    FTM0(C0V) = ROUND / 4;
    FTM0(C1V) = ROUND / 3;
#ifdef INTERRUPTS
    FTM0(SC) = BUS_CLOCK | TOIE;
#else
    FTM0(SC) = BUS_CLOCK;
#endif
    for (;;) {
#ifdef COUNTS
        turns++;
#else
        __asm volatile("wfi");
#endif
    }
}
