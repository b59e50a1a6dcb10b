#include "drivers.h"

#include "registers.h"

enum { RING_BYTES = 16 };

typedef struct {
    volatile uint8_t bytes[RING_BYTES];
    volatile uint32_t written, read;
} ring_t;

static ring_t received, to_send;
volatile float weight = 1.0f; /* interrupts use the FPU too */

/* One writer, one reader, each with its own index. */
static bool ring_put(ring_t *ring, uint8_t byte)
{
    if (ring->written - ring->read == RING_BYTES) {
        return false;
    }
    ring->bytes[ring->written % RING_BYTES] = byte;
    ring->written++;
    return true;
}

static bool ring_get(ring_t *ring, uint8_t *byte)
{
    if (ring->written == ring->read) {
        return false;
    }
    *byte = ring->bytes[ring->read % RING_BYTES];
    ring->read++;
    return true;
}

void clock_start(void)
{
    CLKDIV1 = 0x01140000u; /* core / 1, bus / 2, flash / 5 */
    MCG(0) = 0x98u;        /* from the oscillator */
    MCG(4) = 0x13u;        /* 50 MHz / 20 */
    MCG(5) = 0x58u;        /* PLL: x 48 */
    while ((MCG(6) & 0x40u) == 0u) {
    }
    MCG(0) = 0x18u; /* from the PLL */
    while ((MCG(6) & 0x0Cu) != 0x0Cu) {
    }
}

enum { UART_BDH = 0, UART_BDL = 1, UART_C2 = 3, UART_S1 = 4, UART_D = 7, UART_C4 = 10 };
enum { UART_TIE = 0x80, UART_RIE = 0x20, UART_TE = 0x08, UART_RE = 0x04, UART_TDRE = 0x80, UART_RDRF = 0x20 };

void uart_start(void)
{
    SCGC4 |= 1u << 10;
    UART0(UART_BDH) = 0u;
    UART0(UART_BDL) = 65u;
    UART0(UART_C4) = 3u;
    UART0(UART_C2) = UART_RIE | UART_TE | UART_RE;
    interrupt_enable(IRQ_UART0, 0x20u);
}

bool uart_get(uint8_t *byte)
{
    return ring_get(&received, byte);
}

bool uart_put(uint8_t byte)
{
    if (!ring_put(&to_send, byte)) {
        return false;
    }
    UART0(UART_C2) = UART_TIE | UART_RIE | UART_TE | UART_RE;
    return true;
}

void Interrupt31_Handler(void)
{
    const uint8_t status = UART0(UART_S1);
    uint8_t byte;

    weight = weight * 1.5f + 2.0f;
    if (weight > 1000.0f) {
        weight = 1.0f;
    }
    if ((status & UART_RDRF) != 0u) {
        (void)ring_put(&received, UART0(UART_D));
    }
    if ((status & UART_TDRE) != 0u) {
        if (ring_get(&to_send, &byte)) {
            UART0(UART_D) = byte;
        } else {
            UART0(UART_C2) = UART_RIE | UART_TE | UART_RE;
        }
    }
}

enum { I2C_F = 1, I2C_C1 = 2, I2C_S = 3, I2C_D = 4 };
enum { I2C_EN = 0x80, I2C_IE = 0x40, I2C_MST = 0x20, I2C_TX = 0x10, I2C_TXAK = 0x08, I2C_RSTA = 0x04 };
enum { STEP_REGISTER, STEP_RESTART, STEP_TURN, STEP_LAST, STEP_DONE };

static uint8_t part, wanted;
static volatile uint8_t answer, step;

void i2c_start(void)
{
    SCGC4 |= 1u << 6;
    I2C0(I2C_F) = 0x1Bu; /* bus / 128 */
    I2C0(I2C_C1) = I2C_EN;
    interrupt_enable(IRQ_I2C0, 0x30u);
}

void i2c_read_register(uint8_t address, uint8_t number)
{
    part = address;
    wanted = number;
    step = STEP_REGISTER;
    I2C0(I2C_C1) = I2C_EN | I2C_IE | I2C_MST | I2C_TX;
    I2C0(I2C_D) = (uint8_t)(address << 1);
}

bool i2c_answer(uint8_t *value)
{
    *value = answer;
    return step == STEP_DONE;
}

void Interrupt24_Handler(void)
{
    I2C0(I2C_S) = 0x02u;
    switch (step++) {
    case STEP_REGISTER:
        I2C0(I2C_D) = wanted;
        break;
    case STEP_RESTART:
        I2C0(I2C_C1) = I2C_EN | I2C_IE | I2C_MST | I2C_TX | I2C_RSTA;
        I2C0(I2C_D) = (uint8_t)(part << 1 | 1);
        break;
    case STEP_TURN:
        I2C0(I2C_C1) = I2C_EN | I2C_IE | I2C_MST | I2C_TXAK;
        (void)I2C0(I2C_D);
        break;
    default:
        I2C0(I2C_C1) = I2C_EN;
        answer = I2C0(I2C_D);
        break;
    }
}

volatile uint32_t timer_runs, timer_rounds;

/* Longer than the time between two ticks would allow if it were more urgent: 7 us of every 50. */
void timer_start(void)
{
    SCGC6 |= 1u << 23;
    PIT(0x000) = 0u;
    PIT(0x100) = 2999u; /* 50 us at 60 MHz */
    PIT(0x108) = 3u;
    interrupt_enable(IRQ_PIT0, TIMER_PRIORITY);
}

void Interrupt48_Handler(void)
{
    PIT(0x10C) = 1u;
    timer_runs = 1u;
    for (volatile uint32_t i = 0; i < 100u; i++) {
    }
    timer_runs = 0u;
    timer_rounds++;
}
