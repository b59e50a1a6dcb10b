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

typedef struct bus bus_t;

/** The next step when the byte that is under way has ended; `status` is S with it. */
typedef void (*step_t)(bus_t *bus, uint8_t status);

struct bus {
    uint32_t base;
    const i2c_pins_t *pins;
    volatile step_t step;
    volatile i2c_status_t status;
    uint8_t address;
    uint8_t first_register;
    uint8_t left;         /**< bytes still to move */
    uint8_t flags;        /**< what of the first register decides about the others, 0 when nothing does */
    uint8_t others;       /**< bytes to read then, the first again among them */
    const uint8_t *write; /**< next byte to send, or NULL when reading */
    uint8_t *read;        /**< where the next byte goes */
};

static void after_stop(bus_t *bus, uint8_t status);

static bus_t buses[BUS_COUNT] = {
    {.base = I2C0_BASE, .pins = &i2c0_pins, .step = after_stop},
    {.base = I2C1_BASE, .pins = &i2c1_pins, .step = after_stop},
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

static inline void end(bus_t *bus, i2c_status_t status)
{
    bus->status = status;
    bus->step = after_stop;
    wait_is_over();
}

/** Clearing MST sends the STOP. */
static inline void finish(bus_t *bus, i2c_status_t status)
{
    I2C_C1(bus->base) = C1_IDLE;
    end(bus, status);
}

/** A byte could not be sent, or came while another master had the bus. */
static void fail(bus_t *bus, uint8_t status)
{
    const bool is_lost = (status & I2C_S_ARBL) != 0u;
    if (is_lost) {
        I2C_S(bus->base) = I2C_S_ARBL;
    }
    finish(bus, is_lost ? I2C_ARBITRATION_LOST : I2C_NO_ACKNOWLEDGE);
}

static inline bool has_failed(uint8_t status)
{
    return (status & (I2C_S_ARBL | I2C_S_RXAK)) != 0u;
}

static void after_stop(bus_t *bus, uint8_t status)
{
    (void)bus;
    (void)status;
}

/** A byte is in D, and reading it starts the next one: set before that how the next one is answered, or STOP. */
static void after_byte(bus_t *bus, uint8_t status)
{
    uint8_t *const to = bus->read++;
    const uint8_t left = --bus->left;
    if (__builtin_expect((left > 1u) & ((status & I2C_S_ARBL) == 0u), 1)) { /* most come here, so this is all there is to them */
        *to = I2C_D(bus->base);
        return;
    }
    if ((status & I2C_S_ARBL) != 0u) {
        fail(bus, I2C_S_ARBL);
    } else if (left == 1u) {
        I2C_C1(bus->base) = C1_RECEIVE | I2C_C1_TXAK;
        *to = I2C_D(bus->base);
    } else {
        I2C_C1(bus->base) = C1_IDLE;
        *to = I2C_D(bus->base);
        end(bus, I2C_OK);
    }
}

static inline void start_again(bus_t *bus, step_t step, uint8_t address_byte)
{
    I2C_C1(bus->base) = C1_TRANSMIT | I2C_C1_RSTA;
    bus->step = step;
    I2C_D(bus->base) = address_byte;
}

static void after_address(bus_t *bus, uint8_t status);

/** The flags are in D. As transmitter we read them without starting the next byte, and can send a repeated START as well as STOP. */
static void after_flags(bus_t *bus, uint8_t status)
{
    if ((status & I2C_S_ARBL) != 0u) {
        fail(bus, status);
        return;
    }
    I2C_C1(bus->base) = C1_TRANSMIT;
    const uint8_t flags = I2C_D(bus->base);
    *bus->read = flags;
    if ((flags & bus->flags) == 0u) {
        finish(bus, I2C_OK);
        return;
    }
    bus->flags = 0u;
    bus->left = bus->others;
    start_again(bus, after_address, (uint8_t)(bus->address << 1));
}

/** The receiver starts with a read of D that returns nothing; the last byte must be answered by no acknowledge. */
static void after_read_address(bus_t *bus, uint8_t status)
{
    if (has_failed(status)) {
        fail(bus, status);
        return;
    }
    I2C_C1(bus->base) = bus->left == 1u ? C1_RECEIVE | I2C_C1_TXAK : C1_RECEIVE;
    bus->step = bus->flags != 0u ? after_flags : after_byte;
    (void)I2C_D(bus->base);
}

/** Of what is to be read: START again, for the other direction. */
static void after_register(bus_t *bus, uint8_t status)
{
    if (has_failed(status)) {
        fail(bus, status);
        return;
    }
    start_again(bus, after_read_address, (uint8_t)(bus->address << 1 | 1u));
}

/** The register address or a byte for it was sent. */
static void after_write(bus_t *bus, uint8_t status)
{
    if (has_failed(status)) {
        fail(bus, status);
    } else if (bus->left > 0u) {
        bus->left--;
        I2C_D(bus->base) = *bus->write++;
    } else {
        finish(bus, I2C_OK);
    }
}

static void after_address(bus_t *bus, uint8_t status)
{
    if (has_failed(status)) {
        fail(bus, status);
        return;
    }
    bus->step = bus->write == NULL ? after_register : after_write;
    I2C_D(bus->base) = bus->first_register;
}

/** Runs once a byte, so it is compiled into each handler. */
static inline void bus_interrupt(bus_t *bus)
{
    const uint8_t status = I2C_S(bus->base);
    I2C_S(bus->base) = I2C_S_IICIF;
    bus->step(bus, status);
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
    return ((const bus_t *)context)->step == after_stop;
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
    bus->step = after_address;
    I2C_C1(bus->base) = C1_TRANSMIT; /* setting MST sends the START */
    I2C_D(bus->base) = (uint8_t)(bus->address << 1);
    if (!wait_briefly(is_idle, bus, TRANSACTION_TIMEOUT_US)) {
        I2C_C1(bus->base) = 0u; /* off the bus, so no interrupt can change what follows */
        bus->step = after_stop;
        return I2C_TIMEOUT;
    }
    return bus->status;
}

/** Run a transaction. When a device held a line, make the bus usable for the next one; this one is reported as it ended. */
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

static i2c_status_t read(uint8_t bus, uint8_t address, uint8_t first_register, uint8_t *bytes, uint8_t count)
{
    bus_t *const used = &buses[bus];
    used->address = address;
    used->first_register = first_register;
    used->left = count;
    used->write = NULL;
    used->read = bytes;
    return transact(used);
}

i2c_status_t i2c_read(uint8_t bus, uint8_t address, uint8_t first_register, uint8_t *bytes, uint8_t count)
{
    buses[bus].flags = 0u;
    return read(bus, address, first_register, bytes, count);
}

i2c_status_t i2c_read_if(uint8_t bus, uint8_t address, uint8_t first_register, uint8_t flags, uint8_t *bytes, uint8_t count)
{
    buses[bus].flags = flags;
    buses[bus].others = count;
    return read(bus, address, first_register, bytes, 1u);
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
