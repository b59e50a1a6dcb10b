/* Pends interrupts 1 to 4 in different ways and writes down who runs when. */
#include <stdint.h>

#define REGISTER8(address) (*(volatile uint8_t *)(address))
#define REGISTER(address) (*(volatile uint32_t *)(address))
#define ISER REGISTER(0xE000E100u)
#define ISPR REGISTER(0xE000E200u)
#define ICPR REGISTER(0xE000E280u)
#define STIR REGISTER(0xE000EF00u)
#define ICSR REGISTER(0xE000ED04u)
#define AIRCR REGISTER(0xE000ED0Cu)
#define PRIORITY(number) REGISTER8(0xE000E400u + (number))

volatile uint32_t order_length, depth_seen, readback, pending_seen, pending_in_handler;
volatile uint8_t order[32];

static void note(uint8_t what)
{
    order[order_length++] = what;
}

void Interrupt1_Handler(void)
{
    note(0x11);
    ISPR = 1u << 2; /* more urgent: at once */
    __asm volatile("dsb\n\tisb");
    note(0x12);
    ISPR = 1u << 3; /* less urgent: afterwards */
    pending_in_handler = ICSR >> 12 & 0x1FFu;
    __asm volatile("dsb\n\tisb");
    note(0x13);
}

void Interrupt2_Handler(void)
{
    note(0x21);
    depth_seen = (ICSR >> 11) & 1u; /* RETTOBASE */
}

void Interrupt3_Handler(void)
{
    note(0x31);
}

void Interrupt4_Handler(void)
{
    note(0x41);
}

int main(void)
{
    AIRCR = 0x05FA0000u | (GROUPING << 8);
    PRIORITY(1) = 0x80;
    PRIORITY(2) = URGENT;
    PRIORITY(3) = 0xC0;
    PRIORITY(4) = 0x8F; /* the part has four bits: 0x80 */
    readback = PRIORITY(4);
    ISER = 0x1Eu;
    note(0x01);
    STIR = 1u;
    __asm volatile("dsb\n\tisb");
    note(0x02);
    __asm volatile("cpsid i" ::: "memory");
    ISPR = (1u << 3) | (1u << 4);
    STIR = 2u;
    pending_seen = ICSR >> 12 & 0x1FFu;
    note(0x03);
    __asm volatile("cpsie i\n\tisb" ::: "memory");
    note(0x04);
    __asm volatile("msr basepri, %0\n\tisb" ::"r"(0x80) : "memory");
    ISPR = (1u << 2) | (1u << 3) | (1u << 4);
    __asm volatile("dsb\n\tisb");
    note(0x05);
    ICPR = 1u << 3; /* thought better of it */
    __asm volatile("msr basepri, %0\n\tisb" ::"r"(0) : "memory");
    note(0x06);
    __asm volatile("cpsid f" ::: "memory");
    STIR = 2u;
    __asm volatile("dsb\n\tisb");
    note(0x07);
    __asm volatile("cpsie f\n\tisb" ::: "memory");
    note(0x08);
    return 0;
}
