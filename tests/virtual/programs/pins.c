/* Lights an LED while SW2 is down, by polling; counts the edges of SW3 by interrupt. */
#include <stdint.h>

#define REGISTER(address) (*(volatile uint32_t *)(address))
#define SCGC5 REGISTER(0x40048038u)
#define PCR(port, pin) REGISTER(0x40049000u + 0x1000u * (port) + 4u * (pin))
#define ISFR(port) REGISTER(0x400490A0u + 0x1000u * (port))
#define GPIO(port, offset) REGISTER(0x400FF000u + 0x40u * (port) + (offset))
#define ISER1 REGISTER(0xE000E104u)
enum { A, B, C, D, E };
enum { PDOR = 0x0, PSOR = 0x4, PCOR = 0x8, PTOR = 0xC, PDIR = 0x10, PDDR = 0x14 };

volatile uint32_t edges, seen, floating, pulled_up;

void Interrupt59_Handler(void)
{
    if (PCR(A, 4) & (1u << 24)) {
        seen = ISFR(A);
        edges++;
        ISFR(A) = 1u << 4;
    }
}

int main(void)
{
    SCGC5 |= 0x1Fu << 9;
    PCR(B, 22) = 1u << 8;
    PCR(B, 21) = 1u << 8;
    PCR(E, 26) = 1u << 8;
    GPIO(B, PSOR) = 3u << 21; /* dark before they are outputs */
    GPIO(B, PDDR) = 3u << 21;
    PCR(D, 0) = 1u << 8;
    floating = GPIO(D, PDIR) & 1u;
    PCR(D, 0) = (1u << 8) | 3u;
    pulled_up = GPIO(D, PDIR) & 1u;
    PCR(C, 6) = 1u << 8;
    PCR(A, 4) = (1u << 8) | (10u << 16); /* falling edge */
    ISER1 = 1u << (59 - 32);
    for (;;) {
        if (GPIO(C, PDIR) & (1u << 6)) {
            GPIO(B, PSOR) = 1u << 22;
        } else {
            GPIO(B, PCOR) = 1u << 22;
        }
    }
}
