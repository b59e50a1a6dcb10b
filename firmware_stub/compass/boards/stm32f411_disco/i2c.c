/**
 * @file i2c.c
 * @brief I2C1 on PB6/PB9 as master, by interrupts, 397 kHz.
 *
 * RM0383, section 18.3.3, has the order in which the last bytes of a reading are received: one byte, two bytes, and more each have
 * their own, because ACK and STOP must be set before the byte ends that they are for.
 */
#include "boards/i2c.h"

#include <stdbool.h>
#include <stddef.h>

#include "board_parts.h"
#include "boards/time_base.h"
#include "registers.h"

#define SCL 6u
#define SDA 9u
#define ALTERNATIVE 4u
#define APB1_MHZ (APB1_CLOCK_HZ / 1000000u)
#define CLOCK_397_KHZ 42u /* high for 42 clocks of APB1, low for twice as long */
#define RISE_TIME 16u     /* 300 ns, and one */
/* 40 bytes of 9 bits take 1 ms; no part here stretches the clock. */
#define TRANSACTION_TIMEOUT_US 5000u
#define MAXIMUM_BUSY_LOOKS 2000u
#define HALF_CLOCK_US 5u /* 100 kHz: every part can follow */

#define EVENTS (APB1_MHZ | I2C_CR2_ITERREN | I2C_CR2_ITEVTEN)
#define EVENTS_AND_BYTES (EVENTS | I2C_CR2_ITBUFEN)

/** The transaction under way. */
static struct {
    uint8_t address, first_register;
    bool is_restarted;         /**< START was set for the second time */
    bool is_receiving;         /**< the device answered its address for the second time */
    bool is_register_sent;
    const uint8_t *write;      /**< next byte to send, or NULL when reading */
    uint8_t *read;             /**< where the next byte goes */
    volatile uint32_t left;    /**< bytes still to move */
    volatile bool is_over;
    volatile i2c_status_t status;
} transaction;

void I2C1_Event_Handler(void);
void I2C1_Error_Handler(void);

static void bus_enable(void)
{
    I2C1_CR1 = I2C_CR1_SWRST;
    I2C1_CR1 = 0u;
    I2C1_CR2 = APB1_MHZ;
    I2C1_CCR = I2C_CCR_FAST | CLOCK_397_KHZ;
    I2C1_TRISE = RISE_TIME;
    I2C1_CR1 = I2C_CR1_PE;
}

void i2c_start(void)
{
    GPIO_OTYPER(GPIOB_BASE) |= 1u << SCL | 1u << SDA; /* open drain */
    pin_connect(GPIOB_BASE, SCL, ALTERNATIVE);
    pin_connect(GPIOB_BASE, SDA, ALTERNATIVE);
    bus_enable();
    interrupt_enable(IRQ_I2C1_EVENT);
    interrupt_enable(IRQ_I2C1_ERROR);
}

static void end(i2c_status_t status)
{
    I2C1_CR2 = APB1_MHZ; /* no interrupts until the next transaction */
    transaction.status = status;
    transaction.is_over = true;
    wait_is_over();
}

static void stop(void)
{
    I2C1_CR1 = I2C_CR1_PE | I2C_CR1_STOP;
}

/** The device answered its address; reading SR2 releases the clock. */
static void after_address(void)
{
    transaction.is_receiving = transaction.is_restarted;
    if (!transaction.is_receiving) {
        (void)I2C1_SR2;
        I2C1_CR2 = EVENTS_AND_BYTES; /* TXE comes at once */
    } else if (transaction.left == 1u) {
        I2C1_CR1 = I2C_CR1_PE; /* no acknowledge */
        (void)I2C1_SR2;
        stop();
        I2C1_CR2 = EVENTS_AND_BYTES;
    } else if (transaction.left == 2u) {
        (void)I2C1_SR2;
        I2C1_CR1 = I2C_CR1_PE | I2C_CR1_POS; /* no acknowledge for the second byte; both are read at BTF */
    } else {
        (void)I2C1_SR2;
        I2C1_CR2 = transaction.left > 3u ? EVENTS_AND_BYTES : EVENTS;
    }
}

/** Send the register, the bytes behind it, and STOP or a repeated START when the last one has left. */
static void transmit(uint32_t status)
{
    if (!transaction.is_register_sent) {
        transaction.is_register_sent = true;
        I2C1_DR = transaction.first_register;
        if (transaction.write == NULL) {
            I2C1_CR2 = EVENTS; /* BTF says when it has left */
        }
    } else if (transaction.write != NULL && transaction.left > 0u) {
        transaction.left--;
        I2C1_DR = *transaction.write++;
        if (transaction.left == 0u) {
            I2C1_CR2 = EVENTS;
        }
    } else if ((status & I2C_SR1_BTF) != 0u) {
        if (transaction.write != NULL) {
            stop();
            end(I2C_OK);
        } else {
            transaction.is_restarted = true;
            I2C1_CR1 = I2C_CR1_PE | I2C_CR1_START | I2C_CR1_ACK | (transaction.left == 2u ? I2C_CR1_POS : 0u);
        }
    }
}

static void take_byte(void)
{
    *transaction.read++ = (uint8_t)I2C1_DR;
    transaction.left--;
}

/** Receive: single bytes while more than three are left, then two by BTF, and the last. */
static void receive(uint32_t status)
{
    const bool has_two = (status & I2C_SR1_BTF) != 0u;
    const uint32_t left = transaction.left;
    if (left == 1u) {
        take_byte();
        end(I2C_OK);
    } else if (left > 3u) {
        take_byte();
        if (transaction.left == 3u) {
            I2C1_CR2 = EVENTS; /* the next two come together */
        }
    } else if (has_two && left == 3u) {
        I2C1_CR1 = I2C_CR1_PE; /* no acknowledge for the last byte, which is held back by the one in DR */
        take_byte();
        stop();
        take_byte();
        I2C1_CR2 = EVENTS_AND_BYTES;
    } else if (has_two && left == 2u) {
        stop();
        take_byte();
        take_byte();
        end(I2C_OK);
    }
}

void I2C1_Event_Handler(void)
{
    const uint32_t status = I2C1_SR1;
    if ((status & I2C_SR1_SB) != 0u) {
        I2C1_DR = (uint32_t)transaction.address << 1 | transaction.is_restarted;
    } else if ((status & I2C_SR1_ADDR) != 0u) {
        after_address();
    } else if (transaction.is_receiving && (status & (I2C_SR1_RXNE | I2C_SR1_BTF)) != 0u) {
        receive(status);
    } else if (!transaction.is_restarted && (status & (I2C_SR1_TXE | I2C_SR1_BTF)) != 0u) {
        transmit(status);
    } else {
        /* BTF stays, and interrupts again, until the repeated START is on the bus. */
    }
}

void I2C1_Error_Handler(void)
{
    const uint32_t status = I2C1_SR1;
    I2C1_SR1 = ~status & I2C_SR1_ERRORS;
    if ((status & I2C_SR1_AF) != 0u) {
        stop();
        end(I2C_NO_ACKNOWLEDGE);
    } else {
        end(I2C_ARBITRATION_LOST);
    }
}

static bool is_over(const void *context)
{
    (void)context;
    return transaction.is_over;
}

static bool bus_is_free(void)
{
    for (uint32_t looks = 0; looks < MAXIMUM_BUSY_LOOKS; looks++) {
        if ((I2C1_SR2 & I2C_SR2_BUSY) == 0u) {
            return true;
        }
    }
    return false;
}

static void move_pin(uint32_t pin, uint32_t is_high)
{
    pin_set(GPIOB_BASE, pin, is_high);
    sleep_until_us(time_us() + HALF_CLOCK_US);
}

/** Clock a device out of a byte that it was cut off in, send it a STOP, and start the block again. */
static void free_bus(void)
{
    pin_set(GPIOB_BASE, SCL, 1u);
    pin_set(GPIOB_BASE, SDA, 1u);
    pin_output(GPIOB_BASE, SCL);
    pin_output(GPIOB_BASE, SDA);
    for (uint32_t clock = 0; clock < 9u; clock++) {
        move_pin(SCL, 0u);
        move_pin(SCL, 1u);
    }
    move_pin(SCL, 0u);
    move_pin(SDA, 0u);
    move_pin(SCL, 1u);
    move_pin(SDA, 1u); /* SDA rises while SCL is high: STOP */
    pin_connect(GPIOB_BASE, SCL, ALTERNATIVE);
    pin_connect(GPIOB_BASE, SDA, ALTERNATIVE);
    bus_enable();
}

static i2c_status_t run(void)
{
    if (!bus_is_free()) {
        return I2C_BUS_BUSY;
    }
    transaction.is_restarted = transaction.is_receiving = transaction.is_register_sent = transaction.is_over = false;
    I2C1_CR2 = EVENTS;
    I2C1_CR1 = I2C_CR1_PE | I2C_CR1_START;
    if (!wait_briefly(is_over, NULL, TRANSACTION_TIMEOUT_US)) {
        I2C1_CR2 = APB1_MHZ; /* no interrupt can change the state that follows */
        return I2C_TIMEOUT;
    }
    return transaction.status;
}

static i2c_status_t transact(uint8_t address, uint8_t first_register, const uint8_t *write, uint8_t *read, uint8_t count)
{
    transaction.address = address;
    transaction.first_register = first_register;
    transaction.write = write;
    transaction.read = read;
    transaction.left = count;
    const i2c_status_t status = run();
    if (status != I2C_OK && status != I2C_NO_ACKNOWLEDGE) {
        free_bus();
    }
    return status;
}

i2c_status_t i2c_read(uint8_t bus, uint8_t address, uint8_t first_register, uint8_t *bytes, uint8_t count)
{
    (void)bus; /* there is one */
    return transact(address, first_register, NULL, bytes, count);
}

i2c_status_t i2c_write(uint8_t bus, uint8_t address, uint8_t first_register, const uint8_t *bytes, uint8_t count)
{
    (void)bus;
    return transact(address, first_register, bytes, NULL, count);
}
