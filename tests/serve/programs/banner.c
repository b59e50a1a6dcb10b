/* Says hello as soon as it is out of reset, counts its resets in RAM that start-up code leaves alone, and sleeps. */
#include <stdint.h>

#define REG8(address) (*(volatile uint8_t *)(address))
#define REG32(address) (*(volatile uint32_t *)(address))

static void say(const char *text)
{
    for (; *text; text++) {
        while (!(REG8(0x4006A004) & 0x80)) {
        }
        REG8(0x4006A007) = (uint8_t)*text;
    }
}

void SysTick_Handler(void)
{
}

int main(void)
{
    volatile uint32_t *resets = (volatile uint32_t *)0x20020000;
    char number[] = "boot 0, RCM 00\r\n";
    uint32_t cause = REG8(0x4007F000);

    *(volatile uint16_t *)0x4005200E = 0xC520u; /* watchdog: unlock and disable */
    *(volatile uint16_t *)0x4005200E = 0xD928u;
    *(volatile uint16_t *)0x40052000 = 0x01D2u;
    REG32(0x40048034) |= 1u << 10 | 1u << 19; /* SIM_SCGC4: UART0, CMP */
    REG8(0x4006A000) = 0;
    REG8(0x4006A001) = 11; /* 20.97 MHz out of reset: 16 * (11 + 12/32), 115 220 baud */
    REG8(0x4006A00A) = 12;
    REG8(0x4006A003) = 0x0C;
    number[5] = (char)('0' + (*resets)++ % 10);
    number[12] = "0123456789ABCDEF"[cause >> 4];
    number[13] = "0123456789ABCDEF"[cause & 15];
    say(number);
    for (int k = 0; k < 3; k++) {
        REG8(0x40073000) = 0x11; /* CMP0_CR0, which is not modelled */
    }
    REG32(0xE000E014) = 200000; /* SysTick, so that there is something to sleep for */
    REG32(0xE000E010) = 7;
    for (;;) {
        __asm volatile("wfi");
    }
}
