/* The registers that this program uses. */
#ifndef RTOS_REGISTERS_H
#define RTOS_REGISTERS_H

#include <stdint.h>

#define REGISTER8(address) (*(volatile uint8_t *)(address))
#define REGISTER32(address) (*(volatile uint32_t *)(address))

#define CPACR REGISTER32(0xE000ED88u)
#define ICSR REGISTER32(0xE000ED04u)
#define SYST_CSR REGISTER32(0xE000E010u)
#define SYST_RVR REGISTER32(0xE000E014u)
#define SYST_CVR REGISTER32(0xE000E018u)
#define NVIC_ISER(number) REGISTER32(0xE000E100u + 4u * ((number) / 32u))
#define NVIC_PRIORITY(number) REGISTER8(0xE000E400u + (number))
#define SYSTEM_PRIORITY(exception) REGISTER8(0xE000ED14u + (exception))

#define SCGC4 REGISTER32(0x40048034u)
#define SCGC5 REGISTER32(0x40048038u)
#define SCGC6 REGISTER32(0x4004803Cu)
#define CLKDIV1 REGISTER32(0x40048044u)
#define MCG(offset) REGISTER8(0x40064000u + (offset))
#define UART0(offset) REGISTER8(0x4006A000u + (offset))
#define I2C0(offset) REGISTER8(0x40066000u + (offset))
#define PIT(offset) REGISTER32(0x40037000u + (offset))
#define PORTB_PCR(pin) REGISTER32(0x4004A000u + 4u * (pin))
#define GPIOB_PSOR REGISTER32(0x400FF044u)
#define GPIOB_PTOR REGISTER32(0x400FF04Cu)
#define GPIOB_PDDR REGISTER32(0x400FF054u)

enum { EXCEPTION_SVCALL = 11, EXCEPTION_PENDSV = 14, EXCEPTION_SYSTICK = 15 };
enum { IRQ_I2C0 = 24, IRQ_UART0 = 31, IRQ_PIT0 = 48 };

static inline void interrupt_enable(uint32_t number, uint8_t priority)
{
    NVIC_PRIORITY(number) = priority;
    NVIC_ISER(number) = 1u << (number % 32u);
}

#endif
