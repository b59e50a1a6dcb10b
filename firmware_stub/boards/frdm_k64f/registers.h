/**
 * @file registers.h
 * @brief The registers of MK64FN1M0VLL12 and its Cortex-M4F that this board uses; nothing else.
 *
 * Names and offsets follow the K64 Sub-Family Reference Manual and the ARMv7-M Architecture Reference Manual.
 */
#ifndef HILTEST_REGISTERS_H
#define HILTEST_REGISTERS_H

#include <stdint.h>

#define REGISTER8(address) (*(volatile uint8_t *)(address))
#define REGISTER16(address) (*(volatile uint16_t *)(address))
#define REGISTER32(address) (*(volatile uint32_t *)(address))

/* Watchdog */
#define WDOG_STCTRLH REGISTER16(0x40052000u)
#define WDOG_UNLOCK REGISTER16(0x4005200Eu)

/* Clocks */
#define SIM_SCGC4 REGISTER32(0x40048034u)
#define SIM_SCGC4_I2C0 (1u << 6)
#define SIM_SCGC4_I2C1 (1u << 7)
#define SIM_SCGC4_UART0 (1u << 10)
#define SIM_SCGC5 REGISTER32(0x40048038u)
#define SIM_SCGC5_PORTB (1u << 10)
#define SIM_SCGC5_PORTC (1u << 11)
#define SIM_SCGC5_PORTE (1u << 13)
#define SIM_SCGC6 REGISTER32(0x4004803Cu)
#define SIM_SCGC6_PIT (1u << 23)
#define SIM_CLKDIV1 REGISTER32(0x40048044u)
#define SIM_UIDH REGISTER32(0x40048054u)
#define SIM_UIDMH REGISTER32(0x40048058u)
#define SIM_UIDML REGISTER32(0x4004805Cu)
#define SIM_UIDL REGISTER32(0x40048060u)
#define MCG_C1 REGISTER8(0x40064000u)
#define MCG_C2 REGISTER8(0x40064001u)
#define MCG_C5 REGISTER8(0x40064004u)
#define MCG_C6 REGISTER8(0x40064005u)
#define MCG_S REGISTER8(0x40064006u)
#define MCG_S_CLKST 0x0Cu
#define MCG_S_IREFST 0x10u
#define MCG_S_PLLST 0x20u
#define MCG_S_LOCK0 0x40u

/* Pins */
#define PORTB_BASE 0x4004A000u
#define PORTC_BASE 0x4004B000u
#define PORTE_BASE 0x4004D000u
#define PORT_PCR(base, pin) REGISTER32((base) + 4u * (pin))
#define PORT_PCR_MUX(alternative) ((uint32_t)(alternative) << 8)
#define PORT_PCR_OPEN_DRAIN (1u << 5)

/* The same pins as plain outputs; `base` is one of the ports */
#define GPIOC_BASE 0x400FF080u
#define GPIOE_BASE 0x400FF100u
#define GPIO_PSOR(base) REGISTER32((base) + 0x04u)
#define GPIO_PCOR(base) REGISTER32((base) + 0x08u)
#define GPIO_PDDR(base) REGISTER32((base) + 0x14u)

/* Periodic interrupt timer */
#define PIT_MCR REGISTER32(0x40037000u)
#define PIT_LDVAL(channel) REGISTER32(0x40037100u + 0x10u * (channel))
#define PIT_CVAL(channel) REGISTER32(0x40037104u + 0x10u * (channel))
#define PIT_TCTRL(channel) REGISTER32(0x40037108u + 0x10u * (channel))
#define PIT_TCTRL_ENABLE 0x1u
#define PIT_TCTRL_CHAIN 0x4u

/* UART0 */
#define UART0_BDH REGISTER8(0x4006A000u)
#define UART0_BDL REGISTER8(0x4006A001u)
#define UART0_C1 REGISTER8(0x4006A002u)
#define UART0_C1_IDLE_AFTER_STOP 0x04u
#define UART0_C2 REGISTER8(0x4006A003u)
#define UART0_C2_RE 0x04u
#define UART0_C2_TE 0x08u
#define UART0_C2_ILIE 0x10u
#define UART0_C2_RIE 0x20u
#define UART0_C2_TIE 0x80u
#define UART0_S1 REGISTER8(0x4006A004u)
#define UART0_S1_FE 0x02u
#define UART0_S1_OR 0x08u
#define UART0_S1_IDLE 0x10u
#define UART0_S1_RDRF 0x20u
#define UART0_S1_TDRE 0x80u
#define UART0_C3 REGISTER8(0x4006A006u)
#define UART0_C3_FEIE 0x02u
#define UART0_C3_ORIE 0x08u
#define UART0_D REGISTER8(0x4006A007u)
#define UART0_C4 REGISTER8(0x4006A00Au)
#define UART0_PFIFO REGISTER8(0x4006A010u)
#define UART0_PFIFO_RXFE 0x08u
#define UART0_PFIFO_TXFE 0x80u
#define UART0_CFIFO REGISTER8(0x4006A011u)
#define UART0_CFIFO_RXFLUSH 0x40u
#define UART0_CFIFO_TXFLUSH 0x80u
#define UART0_SFIFO REGISTER8(0x4006A012u)
#define UART0_SFIFO_RXUF 0x01u
#define UART0_SFIFO_RXOF 0x04u
#define UART0_TWFIFO REGISTER8(0x4006A013u)
#define UART0_RWFIFO REGISTER8(0x4006A015u)
#define UART0_RCFIFO REGISTER8(0x4006A016u)

/* I2C; `base` is one of the two */
#define I2C0_BASE 0x40066000u
#define I2C1_BASE 0x40067000u
#define I2C_F(base) REGISTER8((base) + 1u)
#define I2C_C1(base) REGISTER8((base) + 2u)
#define I2C_C1_RSTA 0x04u
#define I2C_C1_TXAK 0x08u
#define I2C_C1_TX 0x10u
#define I2C_C1_MST 0x20u
#define I2C_C1_IICIE 0x40u
#define I2C_C1_IICEN 0x80u
#define I2C_S(base) REGISTER8((base) + 3u)
#define I2C_S_RXAK 0x01u
#define I2C_S_IICIF 0x02u
#define I2C_S_ARBL 0x10u
#define I2C_S_BUSY 0x20u
#define I2C_D(base) REGISTER8((base) + 4u)

/* System control space of the core */
#define SYST_CSR REGISTER32(0xE000E010u)
#define SYST_CSR_ENABLE 0x1u
#define SYST_CSR_TICKINT 0x2u
#define SYST_CSR_CORE_CLOCK 0x4u
#define SYST_RVR REGISTER32(0xE000E014u)
#define SYST_CVR REGISTER32(0xE000E018u)
#define NVIC_WORDS 3u /* 86 interrupts */
#define NVIC_ISER(word) REGISTER32(0xE000E100u + 4u * (word))
#define NVIC_ICER(word) REGISTER32(0xE000E180u + 4u * (word))
#define SCB_AIRCR REGISTER32(0xE000ED0Cu)
#define SCB_AIRCR_SYSRESETREQ 0x05FA0004u
#define SCB_SCR REGISTER32(0xE000ED10u)
#define SCB_SCR_SLEEPONEXIT 0x2u
#define SCB_CFSR REGISTER32(0xE000ED28u)
#define SCB_HFSR REGISTER32(0xE000ED2Cu)
#define SCB_BFAR REGISTER32(0xE000ED38u)
#define SCB_CPACR REGISTER32(0xE000ED88u)
#define SCB_CPACR_FPU_FULL_ACCESS (0xFu << 20)
#define DHCSR REGISTER32(0xE000EDF0u)
#define DHCSR_DEBUGGER 0x1u
#define DEMCR REGISTER32(0xE000EDFCu)
#define DEMCR_TRCENA (1u << 24)
#define DWT_CTRL REGISTER32(0xE0001000u)
#define DWT_CTRL_CYCCNTENA 0x1u
#define DWT_CTRL_NOCYCCNT (1u << 25)
#define DWT_CYCCNT REGISTER32(0xE0001004u)

/* Flash memory controller */
#define FMC_PFB0CR REGISTER32(0x4001F004u)
#define FMC_PFB1CR REGISTER32(0x4001F008u)
#define FMC_PFB_BUFFER 0x01u
#define FMC_PFB_PREFETCH 0x06u           /* of instructions and of data, and so the cache: */
#define FMC_PFB_CACHE 0x18u
#define FMC_PFB_INVALIDATE (0x1Fu << 19) /* that buffer, and the four ways of the cache; in PFB0CR alone */

/* Interrupt numbers */
#define IRQ_I2C0 24u
#define IRQ_I2C1 25u
#define IRQ_UART0_STATUS 31u
#define IRQ_UART0_ERROR 32u

/** Let an interrupt through to the core. */
static inline void interrupt_enable(uint32_t number)
{
    NVIC_ISER(number / 32u) = 1u << (number % 32u);
}

#endif
