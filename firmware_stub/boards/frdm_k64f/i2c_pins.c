/**
 * @file i2c_pins.c
 * @brief PTE24/PTE25 (on-board sensor) and PTC10/PTC11 (shield).
 */
#include "i2c_pins.h"

#include "boards/time_base.h"
#include "registers.h"

#define HALF_CLOCK_US 5u /* 100 kHz: every part can follow */
#define MUX_GPIO 1u

const i2c_pins_t i2c0_pins = {.pcr_base = PORTE_BASE, .gpio_base = GPIOE_BASE, .scl = 24, .sda = 25, .alternative = 5};
const i2c_pins_t i2c1_pins = {.pcr_base = PORTC_BASE, .gpio_base = GPIOC_BASE, .scl = 10, .sda = 11, .alternative = 2};

static void connect(const i2c_pins_t *pins, uint8_t alternative)
{
    PORT_PCR(pins->pcr_base, pins->scl) = PORT_PCR_MUX(alternative) | PORT_PCR_OPEN_DRAIN;
    PORT_PCR(pins->pcr_base, pins->sda) = PORT_PCR_MUX(alternative) | PORT_PCR_OPEN_DRAIN;
}

void i2c_pins_connect(const i2c_pins_t *pins)
{
    connect(pins, pins->alternative);
}

static void hold(const i2c_pins_t *pins, uint8_t pin)
{
    GPIO_PCOR(pins->gpio_base) = 1u << pin;
    sleep_until_us(time_us() + HALF_CLOCK_US);
}

static void release(const i2c_pins_t *pins, uint8_t pin)
{
    GPIO_PSOR(pins->gpio_base) = 1u << pin;
    sleep_until_us(time_us() + HALF_CLOCK_US);
}

void i2c_pins_free_bus(const i2c_pins_t *pins)
{
    const uint32_t both = 1u << pins->scl | 1u << pins->sda;
    GPIO_PSOR(pins->gpio_base) = both; /* open drain: 1 lets the line go */
    GPIO_PDDR(pins->gpio_base) |= both;
    connect(pins, MUX_GPIO);
    for (uint32_t clock = 0; clock < 9u; clock++) {
        hold(pins, pins->scl);
        release(pins, pins->scl);
    }
    hold(pins, pins->scl);
    hold(pins, pins->sda);
    release(pins, pins->scl);
    release(pins, pins->sda); /* SDA rises while SCL is high: STOP */
    GPIO_PDDR(pins->gpio_base) &= ~both;
    i2c_pins_connect(pins);
}
