/**
 * @file uart.c
 * @brief USART2 on PA2/PA3: 115200 baud, 8 data bits, no parity. DMA1 sends by stream 6; an interrupt takes each received byte.
 */
#include "boards/uart.h"

#include <string.h>

#include "board_parts.h"
#include "boards/time_base.h"
#include "registers.h"
#include "store.h"

#define BAUD 115200u
#define STREAM6_CHANNEL 4u /* USART2_TX */
#define ALTERNATIVE 7u

static volatile bool is_sending;

/* A typed line, until the main loop takes it; bytes that come meanwhile are lost, as are those that do not fit. */
static char line[16];
static volatile uint32_t length;
static volatile bool is_complete;

void USART2_Handler(void);
void DMA1_Stream6_Handler(void);

void uart_start(void)
{
    pin_connect(GPIOA_BASE, 2u, ALTERNATIVE);
    pin_connect(GPIOA_BASE, 3u, ALTERNATIVE);
    GPIO_PUPDR(GPIOA_BASE) |= 1u << (2u * 3u); /* an open input is idle */
    USART2_BRR = (APB1_CLOCK_HZ + BAUD / 2u) / BAUD; /* 434: +0.006 % */
    USART2_CR3 = USART_CR3_DMAT;
    USART2_CR1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    DMA1_S6PAR = (uint32_t)(uintptr_t)&USART2_DR;
    interrupt_enable(IRQ_USART2);
    interrupt_enable(IRQ_DMA1_STREAM6);
}

void USART2_Handler(void)
{
    (void)USART2_SR; /* this read and the next one clear the errors, too */
    const char byte = (char)USART2_DR;
    if (is_complete) {
        return;
    }
    if (byte == '\r' || byte == '\n') {
        is_complete = length > 0u;
    } else if (length < sizeof line) {
        line[length++] = byte;
    }
}

bool typed_line_is(const char *text)
{
    if (!is_complete) {
        return false;
    }
    const bool is_same = length == strlen(text) && memcmp(line, text, length) == 0;
    length = 0u;
    is_complete = false;
    return is_same;
}

void DMA1_Stream6_Handler(void)
{
    DMA1_HIFCR = DMA1_HIFCR_STREAM6;
    is_sending = false; /* also after an error: the line is lost, and the next one is sent */
    wait_is_over();
}

void uart_send(const uint8_t *bytes, size_t count)
{
    if (count == 0u) {
        return;
    }
    is_sending = true;
    DMA1_HIFCR = DMA1_HIFCR_STREAM6; /* the stream starts only without flags */
    USART2_SR = ~USART_SR_TC;
    DMA1_S6M0AR = (uint32_t)(uintptr_t)bytes;
    DMA1_S6NDTR = (uint32_t)count;
    __asm volatile("dsb" ::: "memory"); /* the bytes are in memory before the DMA reads them */
    DMA1_S6CR = DMA_SCR_CHSEL(STREAM6_CHANNEL) | DMA_SCR_MINC | DMA_SCR_DIR_TO_PERIPHERAL | DMA_SCR_TCIE | DMA_SCR_TEIE | DMA_SCR_EN;
}

static bool all_handed_over(const void *context)
{
    (void)context;
    return !is_sending;
}

bool uart_wait_until_sent(uint64_t deadline_us)
{
    return wait_until(all_handed_over, (const void *)0, deadline_us);
}
