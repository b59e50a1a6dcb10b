/*
 * Somebody else's firmware: no interrupts, no sleep, 9600 baud from the reset clock, a protocol of
 * its own. Answers each byte in upper case; '!' ends in an undefined instruction, '.' in a loop that
 * nothing can end, '?' in one that waits for a register.
 */
#include <stdint.h>

#define BYTE(address) (*(volatile uint8_t *)(address))
#define HALF(address) (*(volatile uint16_t *)(address))
#define WORD(address) (*(volatile uint32_t *)(address))

#define UART0 0x4006A000u
#define TDRE 0x80u
#define RDRF 0x20u

static void set_up(void)
{
    HALF(0x4005200E) = 0xC520u; /* watchdog: unlock and disable */
    HALF(0x4005200E) = 0xD928u;
    HALF(0x40052000) = 0x01D2u;
    WORD(0x40048034) |= 1u << 10; /* SIM_SCGC4: UART0 */
    BYTE(UART0 + 0x0) = 0u;       /* 20.97 MHz / 16 / (136 + 17/32) = 9600 baud */
    BYTE(UART0 + 0x1) = 136u;
    BYTE(UART0 + 0xA) = 17u;
    BYTE(UART0 + 0x3) = 0x0Cu;
    WORD(0x40004000) = 0x02u; /* AXBS_PRS0: nothing here depends on it */
}

static void send(uint8_t byte)
{
    while ((BYTE(UART0 + 0x4) & TDRE) == 0u) {
    }
    BYTE(UART0 + 0x7) = byte;
}

int main(void)
{
    set_up();
    for (;;) {
        if ((BYTE(UART0 + 0x4) & RDRF) == 0u) {
            continue;
        }
        uint8_t byte = BYTE(UART0 + 0x7);
        if (byte == '!') {
            __asm volatile("udf #0");
        }
        if (byte == '.') {
            for (;;) {
            }
        }
        while (byte == '?' && (WORD(0x40004010) & 1u) == 0u) { /* AXBS_CRS0 */
        }
        send((byte >= 'a' && byte <= 'z') ? (uint8_t)(byte - 0x20u) : byte);
    }
}
