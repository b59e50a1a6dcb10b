/**
 * @file i2c_pins.h
 * @brief The pins of the two I2C buses, and a way to free a bus that a part holds.
 */
#ifndef HILTEST_I2C_PINS_H
#define HILTEST_I2C_PINS_H

#include <stdint.h>

typedef struct {
    uint32_t pcr_base;   /**< address of the port's pin control registers */
    uint32_t gpio_base;  /**< address of the port's GPIO registers */
    uint8_t scl, sda;    /**< pin numbers */
    uint8_t alternative; /**< multiplexer setting that connects the I2C module */
} i2c_pins_t;

extern const i2c_pins_t i2c0_pins;
extern const i2c_pins_t i2c1_pins;

/** Connect the pins to their I2C module, open drain. */
void i2c_pins_connect(const i2c_pins_t *pins);

/**
 * Clock nine times and send a STOP by hand, then connect the module again.
 *
 * A part that was interrupted in the middle of a byte it sends, by a reset of this processor, holds SDA for a 0 and waits for
 * clocks that never come; after at most nine it lets go. The module must be off.
 */
void i2c_pins_free_bus(const i2c_pins_t *pins);

#endif
