/**
 * @file registers.h
 * @brief The registers of the STM32F411VE and its Cortex-M4F that this board uses; nothing else.
 *
 * Names, addresses and bits follow ST's reference manual RM0383 and the ARMv7-M Architecture Reference Manual.
 */
#ifndef COMPASS_STM32F411_REGISTERS_H
#define COMPASS_STM32F411_REGISTERS_H

#include <stdint.h>

#define REGISTER8(address) (*(volatile uint8_t *)(address))
#define REGISTER32(address) (*(volatile uint32_t *)(address))

/* Reset and clock control */
#define RCC_CR REGISTER32(0x40023800u)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_PLLCFGR REGISTER32(0x40023804u)
#define RCC_PLLCFGR_RESERVED 0xF0BC8000u /* stay as they are after reset */
#define RCC_CFGR REGISTER32(0x40023808u)
#define RCC_CFGR_SW_PLL 0x2u
#define RCC_CFGR_SWS 0xCu
#define RCC_CFGR_SWS_PLL 0x8u
#define RCC_CFGR_PPRE1_DIV2 (4u << 10)
#define RCC_AHB1ENR REGISTER32(0x40023830u)
#define RCC_AHB1ENR_GPIOA (1u << 0)
#define RCC_AHB1ENR_GPIOB (1u << 1)
#define RCC_AHB1ENR_GPIOE (1u << 4)
#define RCC_AHB1ENR_DMA1 (1u << 21)
#define RCC_APB1ENR REGISTER32(0x40023840u)
#define RCC_APB1ENR_TIM2 (1u << 0)
#define RCC_APB1ENR_USART2 (1u << 17)
#define RCC_APB1ENR_I2C1 (1u << 21)
#define RCC_APB1ENR_PWR (1u << 28)
#define RCC_APB2ENR REGISTER32(0x40023844u)
#define RCC_APB2ENR_SPI1 (1u << 12)
#define RCC_APB2ENR_SYSCFG (1u << 14)

/* Power control */
#define PWR_CR REGISTER32(0x40007000u)
#define PWR_CR_VOS_SCALE_1 (3u << 14)
#define PWR_CSR REGISTER32(0x40007004u)
#define PWR_CSR_VOSRDY (1u << 14)

/* Flash interface */
#define FLASH_ACR REGISTER32(0x40023C00u)
#define FLASH_ACR_LATENCY 0xFu
#define FLASH_ACR_PRFTEN (1u << 8)
#define FLASH_ACR_ICEN (1u << 9)
#define FLASH_ACR_DCEN (1u << 10)
#define FLASH_ACR_DCRST (1u << 12)
#define FLASH_KEYR REGISTER32(0x40023C04u)
#define FLASH_KEY1 0x45670123u
#define FLASH_KEY2 0xCDEF89ABu
#define FLASH_SR REGISTER32(0x40023C0Cu)
#define FLASH_SR_EOP (1u << 0)
#define FLASH_SR_ERRORS 0x1F2u /* OPERR, WRPERR, PGAERR, PGPERR, PGSERR, RDERR */
#define FLASH_SR_BSY (1u << 16)
#define FLASH_CR REGISTER32(0x40023C10u)
#define FLASH_CR_PG (1u << 0)
#define FLASH_CR_SER (1u << 1)
#define FLASH_CR_SNB(sector) ((uint32_t)(sector) << 3)
#define FLASH_CR_PSIZE_WORD (2u << 8)
#define FLASH_CR_STRT (1u << 16)
#define FLASH_CR_LOCK (1u << 31)

/* Pins; `base` is one of the ports */
#define GPIOA_BASE 0x40020000u
#define GPIOB_BASE 0x40020400u
#define GPIOE_BASE 0x40021000u
#define GPIO_MODER(base) REGISTER32((base) + 0x00u)
#define GPIO_OTYPER(base) REGISTER32((base) + 0x04u)
#define GPIO_OSPEEDR(base) REGISTER32((base) + 0x08u)
#define GPIO_SPEED_MEDIUM 1u
#define GPIO_PUPDR(base) REGISTER32((base) + 0x0Cu)
#define GPIO_IDR(base) REGISTER32((base) + 0x10u)
#define GPIO_BSRR(base) REGISTER32((base) + 0x18u)
#define GPIO_AFR(base, word) REGISTER32((base) + 0x20u + 4u * (word))

/* Interrupts of pins */
#define SYSCFG_EXTICR1 REGISTER32(0x40013808u)
#define SYSCFG_EXTICR1_EXTI2_PE (4u << 8)
#define EXTI_IMR REGISTER32(0x40013C00u)
#define EXTI_RTSR REGISTER32(0x40013C08u)
#define EXTI_PR REGISTER32(0x40013C14u)

/* Timer 2, 32 bits */
#define TIM2_CR1 REGISTER32(0x40000000u)
#define TIM2_CR1_CEN 0x1u
#define TIM2_DIER REGISTER32(0x4000000Cu)
#define TIM2_DIER_UIE 0x1u
#define TIM2_SR REGISTER32(0x40000010u)
#define TIM2_SR_UIF 0x1u
#define TIM2_EGR REGISTER32(0x40000014u)
#define TIM2_EGR_UG 0x1u
#define TIM2_CNT REGISTER32(0x40000024u)
#define TIM2_PSC REGISTER32(0x40000028u)
#define TIM2_ARR REGISTER32(0x4000002Cu)

/* USART2 */
#define USART2_SR REGISTER32(0x40004400u)
#define USART_SR_TC (1u << 6)
#define USART2_DR REGISTER32(0x40004404u)
#define USART2_BRR REGISTER32(0x40004408u)
#define USART2_CR1 REGISTER32(0x4000440Cu)
#define USART_CR1_RE (1u << 2)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_RXNEIE (1u << 5)
#define USART_CR1_UE (1u << 13)
#define USART2_CR3 REGISTER32(0x40004414u)
#define USART_CR3_DMAT (1u << 7)

/* DMA1, stream 6 */
#define DMA1_HIFCR REGISTER32(0x4002600Cu)
#define DMA1_HIFCR_STREAM6 0x003D0000u /* all of its flags */
#define DMA1_S6CR REGISTER32(0x400260A0u)
#define DMA_SCR_EN (1u << 0)
#define DMA_SCR_TEIE (1u << 2)
#define DMA_SCR_TCIE (1u << 4)
#define DMA_SCR_DIR_TO_PERIPHERAL (1u << 6)
#define DMA_SCR_MINC (1u << 10)
#define DMA_SCR_CHSEL(channel) ((uint32_t)(channel) << 25)
#define DMA1_S6NDTR REGISTER32(0x400260A4u)
#define DMA1_S6PAR REGISTER32(0x400260A8u)
#define DMA1_S6M0AR REGISTER32(0x400260ACu)

/* I2C1 */
#define I2C1_CR1 REGISTER32(0x40005400u)
#define I2C_CR1_PE (1u << 0)
#define I2C_CR1_START (1u << 8)
#define I2C_CR1_STOP (1u << 9)
#define I2C_CR1_ACK (1u << 10)
#define I2C_CR1_POS (1u << 11)
#define I2C_CR1_SWRST (1u << 15)
#define I2C1_CR2 REGISTER32(0x40005404u)
#define I2C_CR2_ITERREN (1u << 8)
#define I2C_CR2_ITEVTEN (1u << 9)
#define I2C_CR2_ITBUFEN (1u << 10)
#define I2C1_DR REGISTER32(0x40005410u)
#define I2C1_SR1 REGISTER32(0x40005414u)
#define I2C_SR1_SB (1u << 0)
#define I2C_SR1_ADDR (1u << 1)
#define I2C_SR1_BTF (1u << 2)
#define I2C_SR1_RXNE (1u << 6)
#define I2C_SR1_TXE (1u << 7)
#define I2C_SR1_AF (1u << 10)
#define I2C_SR1_ERRORS 0xDF00u
#define I2C1_SR2 REGISTER32(0x40005418u)
#define I2C_SR2_BUSY (1u << 1)
#define I2C1_CCR REGISTER32(0x4000541Cu)
#define I2C_CCR_FAST (1u << 15)
#define I2C1_TRISE REGISTER32(0x40005420u)

/* SPI1 */
#define SPI1_CR1 REGISTER32(0x40013000u)
#define SPI_CR1_CPHA (1u << 0)
#define SPI_CR1_CPOL (1u << 1)
#define SPI_CR1_MSTR (1u << 2)
#define SPI_CR1_DIV16 (3u << 3)
#define SPI_CR1_SPE (1u << 6)
#define SPI_CR1_SSI (1u << 8)
#define SPI_CR1_SSM (1u << 9)
#define SPI1_SR REGISTER32(0x40013008u)
#define SPI_SR_RXNE (1u << 0)
#define SPI_SR_TXE (1u << 1)
#define SPI_SR_BSY (1u << 7)
#define SPI1_DR REGISTER8(0x4001300Cu)

/* System control space of the core */
#define SYST_CSR REGISTER32(0xE000E010u)
#define SYST_CSR_ENABLE 0x1u
#define SYST_CSR_TICKINT 0x2u
#define SYST_CSR_CORE_CLOCK 0x4u
#define SYST_RVR REGISTER32(0xE000E014u)
#define SYST_CVR REGISTER32(0xE000E018u)
#define NVIC_ISER(word) REGISTER32(0xE000E100u + 4u * (word))
#define SCB_AIRCR REGISTER32(0xE000ED0Cu)
#define SCB_AIRCR_SYSRESETREQ 0x05FA0004u
#define SCB_SCR REGISTER32(0xE000ED10u)
#define SCB_SCR_SLEEPONEXIT 0x2u
#define SCB_CPACR REGISTER32(0xE000ED88u)
#define SCB_CPACR_FPU_FULL_ACCESS (0xFu << 20)
#define DHCSR REGISTER32(0xE000EDF0u)
#define DHCSR_DEBUGGER 0x1u

/* Interrupt numbers */
#define IRQ_EXTI2 8u
#define IRQ_DMA1_STREAM6 17u
#define IRQ_TIM2 28u
#define IRQ_I2C1_EVENT 31u
#define IRQ_I2C1_ERROR 32u
#define IRQ_USART2 38u
#define IRQ_COUNT 86u

/** Let an interrupt through to the core. */
static inline void interrupt_enable(uint32_t number)
{
    NVIC_ISER(number / 32u) = 1u << (number % 32u);
}

/** Give a pin to a block. */
static inline void pin_connect(uint32_t base, uint32_t pin, uint32_t alternative)
{
    GPIO_AFR(base, pin / 8u) = (GPIO_AFR(base, pin / 8u) & ~(0xFu << (pin % 8u * 4u))) | alternative << (pin % 8u * 4u);
    GPIO_MODER(base) = (GPIO_MODER(base) & ~(3u << (2u * pin))) | 2u << (2u * pin);
}

/** Make a pin an output. */
static inline void pin_output(uint32_t base, uint32_t pin)
{
    GPIO_MODER(base) = (GPIO_MODER(base) & ~(3u << (2u * pin))) | 1u << (2u * pin);
}

static inline void pin_set(uint32_t base, uint32_t pin, uint32_t is_high)
{
    GPIO_BSRR(base) = 1u << (is_high != 0u ? pin : pin + 16u);
}

static inline uint32_t primask_set(void)
{
    uint32_t mask;
    __asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(mask)::"memory");
    return mask;
}

static inline void primask_restore(uint32_t mask)
{
    __asm volatile("msr primask, %0" ::"r"(mask) : "memory");
}

#endif
