/**
 * @file i2c.c
 * @brief I2C0 (on-board sensor) and I2C1 (shield) as masters, one interrupt a byte, 375 kHz.
 */
#include "boards/i2c.h"

#include <stdbool.h>
#include <stddef.h>

#include "board_parts.h"
#include "i2c_pins.h"
#include "registers.h"
#include "boards/time_base.h"

#define BUS_COUNT 2u
/* MULT = 0, ICR = 0x1D: 60 MHz / 160. The parts allow 400 kHz. */
#define FREQUENCY_375_KHZ 0x1Du
/* 40 bytes of 9 bits take 1 ms; no part here stretches the clock. */
#define TRANSACTION_TIMEOUT_US 5000u
/* A STOP takes about one bit, 2.7 us; a look at BUSY at least 6 core cycles, so this is 0.1 ms or more. */
#define MAXIMUM_BUSY_LOOKS 2000u

#define C1_IDLE I2C_C1_IICEN
#define C1_TRANSMIT (I2C_C1_IICEN | I2C_C1_IICIE | I2C_C1_MST | I2C_C1_TX)
#define C1_RECEIVE (I2C_C1_IICEN | I2C_C1_IICIE | I2C_C1_MST)

/** What the interrupt that comes next reports the end of. */
typedef enum { STEP_IDLE, STEP_ADDRESS, STEP_WRITE, STEP_READ_ADDRESS, STEP_READ } step_t;

typedef struct {
    uint32_t base;
    const i2c_pins_t *pins;
    volatile step_t step;
    volatile i2c_status_t status;
    uint8_t address;
    uint8_t first_register;
    uint8_t left;         /**< bytes still to move */
    const uint8_t *write; /**< next byte to send, or NULL when reading */
    uint8_t *read;        /**< where the next byte goes */
} bus_t;

static bus_t buses[BUS_COUNT] = {
    {.base = I2C0_BASE, .pins = &i2c0_pins},
    {.base = I2C1_BASE, .pins = &i2c1_pins},
};

void I2C0_Handler(void);
void I2C1_Handler(void);

static void bus_enable(const bus_t *bus)
{
    I2C_C1(bus->base) = 0u;
    I2C_F(bus->base) = FREQUENCY_375_KHZ;
    I2C_S(bus->base) = I2C_S_IICIF | I2C_S_ARBL;
    I2C_C1(bus->base) = C1_IDLE;
}

void i2c_start(void)
{
    SIM_SCGC4 |= SIM_SCGC4_I2C0 | SIM_SCGC4_I2C1;
    i2c_pins_connect(&i2c0_pins);
    i2c_pins_connect(&i2c1_pins);
    bus_enable(&buses[0]);
    bus_enable(&buses[1]);
    interrupt_enable(IRQ_I2C0);
    interrupt_enable(IRQ_I2C1);
}

/** Clearing MST sends the STOP. */
static void finish(bus_t *bus, i2c_status_t status)
{
    I2C_C1(bus->base) = C1_IDLE;
    bus->status = status;
    bus->step = STEP_IDLE;
    wait_is_over();
}

/** The register address or a data byte was acknowledged: send what comes next. */
static void written(bus_t *bus)
{
    if (bus->write == NULL) {
        I2C_C1(bus->base) = C1_TRANSMIT | I2C_C1_RSTA;
        bus->step = STEP_READ_ADDRESS;
        I2C_D(bus->base) = (uint8_t)(bus->address << 1 | 1u);
    } else if (bus->left > 0u) {
        bus->left--;
        I2C_D(bus->base) = *bus->write++;
    } else {
        finish(bus, I2C_OK);
    }
}

/** The receiver starts with a read of D that returns nothing; the last byte must be answered by no acknowledge. */
static void start_reading(bus_t *bus)
{
    I2C_C1(bus->base) = bus->left == 1u ? C1_RECEIVE | I2C_C1_TXAK : C1_RECEIVE;
    bus->step = STEP_READ;
    (void)I2C_D(bus->base);
}

/** A byte is in D, and reading it starts the next one: set before that how the next one is answered, or STOP. */
static void byte_came(bus_t *bus)
{
    bus->left--;
    if (bus->left == 0u) {
        finish(bus, I2C_OK);
    } else if (bus->left == 1u) {
        I2C_C1(bus->base) = C1_RECEIVE | I2C_C1_TXAK;
    }
    *bus->read++ = I2C_D(bus->base);
}

static void bus_interrupt(bus_t *bus)
{
    const uint8_t status = I2C_S(bus->base);
    I2C_S(bus->base) = I2C_S_IICIF;
    if ((status & I2C_S_ARBL) != 0u) {
        I2C_S(bus->base) = I2C_S_ARBL;
        finish(bus, I2C_ARBITRATION_LOST);
    } else if (bus->step == STEP_READ) {
        byte_came(bus);
    } else if ((status & I2C_S_RXAK) != 0u) {
        finish(bus, I2C_NO_ACKNOWLEDGE);
    } else if (bus->step == STEP_ADDRESS) {
        bus->step = STEP_WRITE;
        I2C_D(bus->base) = bus->first_register;
    } else if (bus->step == STEP_READ_ADDRESS) {
        start_reading(bus);
    } else if (bus->step == STEP_WRITE) {
        written(bus);
    }
}

void I2C0_Handler(void)
{
    bus_interrupt(&buses[0]);
}

void I2C1_Handler(void)
{
    bus_interrupt(&buses[1]);
}

static bool is_idle(const void *context)
{
    return ((const bus_t *)context)->step == STEP_IDLE;
}

static bool bus_is_free(const bus_t *bus)
{
    for (uint32_t looks = 0; looks < MAXIMUM_BUSY_LOOKS; looks++) {
        if ((I2C_S(bus->base) & I2C_S_BUSY) == 0u) {
            return true;
        }
    }
    return false;
}

/** Run the transaction that `bus` describes. */
static i2c_status_t run(bus_t *bus)
{
    if (!bus_is_free(bus)) {
        return I2C_BUS_BUSY;
    }
    bus->step = STEP_ADDRESS;
    I2C_C1(bus->base) = C1_TRANSMIT; /* setting MST sends the START */
    I2C_D(bus->base) = (uint8_t)(bus->address << 1);
    if (!wait_briefly(is_idle, bus, TRANSACTION_TIMEOUT_US)) {
        I2C_C1(bus->base) = 0u; /* off the bus, so no interrupt can change what follows */
        bus->step = STEP_IDLE;
        return I2C_TIMEOUT;
    }
    return bus->status;
}

/** Run a transaction. When somebody held a line, make the bus usable for the next one; this one is reported as it ended. */
static i2c_status_t transact(bus_t *bus)
{
    const i2c_status_t status = run(bus);
    if (status != I2C_OK && status != I2C_NO_ACKNOWLEDGE) {
        I2C_C1(bus->base) = 0u;
        i2c_pins_free_bus(bus->pins);
        bus_enable(bus);
    }
    return status;
}

i2c_status_t i2c_read(uint8_t bus, uint8_t address, uint8_t first_register, uint8_t *bytes, uint8_t count)
{
    bus_t *const used = &buses[bus];
    used->address = address;
    used->first_register = first_register;
    used->left = count;
    used->write = NULL;
    used->read = bytes;
    return transact(used);
}

i2c_status_t i2c_write(uint8_t bus, uint8_t address, uint8_t first_register, const uint8_t *bytes, uint8_t count)
{
    bus_t *const used = &buses[bus];
    used->address = address;
    used->first_register = first_register;
    used->left = count;
    used->write = bytes;
    used->read = NULL;
    return transact(used);
}
