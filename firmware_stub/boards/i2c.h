/**
 * @file i2c.h
 * @brief Register reads and writes on an I2C bus, as all sensors here want them.
 */
#ifndef HILTEST_I2C_H
#define HILTEST_I2C_H

#include <stdint.h>

typedef enum {
    I2C_OK = 0,
    I2C_NO_ACKNOWLEDGE,   /**< nothing answered at this address, or a byte was refused */
    I2C_ARBITRATION_LOST, /**< another device pulled a line */
    I2C_BUS_BUSY,         /**< the bus did not become free */
    I2C_TIMEOUT,          /**< the transaction did not end in time; the bus was reset */
} i2c_status_t;

/**
 * Read consecutive registers: START, address, register, repeated START, `count` bytes, STOP.
 *
 * @param bus index of the bus
 * @param address 7-bit device address
 * @param first_register register address of the first byte
 * @param[out] bytes what was read; undefined unless I2C_OK
 * @param count at least 1
 */
i2c_status_t i2c_read(uint8_t bus, uint8_t address, uint8_t first_register, uint8_t *bytes, uint8_t count);

/**
 * Read a register of flags, and consecutive registers from it on if one of some flags is set: both within one transaction, so no
 * other begins in between.
 *
 * @param flags which flags of the first register
 * @param[out] bytes all of them if one of `flags` is set in the first; otherwise the first alone
 * The others as i2c_read().
 */
i2c_status_t i2c_read_if(uint8_t bus, uint8_t address, uint8_t first_register, uint8_t flags, uint8_t *bytes, uint8_t count);

/** Write consecutive registers: START, address, register, `count` bytes, STOP. Parameters as i2c_read(). */
i2c_status_t i2c_write(uint8_t bus, uint8_t address, uint8_t first_register, const uint8_t *bytes, uint8_t count);

#endif
