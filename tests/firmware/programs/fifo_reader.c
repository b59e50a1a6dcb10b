/**
 * @file fifo_reader.c
 * @brief Drains the FIFOs of the shield's gyroscope and accelerometer in bursts, as firmware does that sleeps long.
 */
#include "boards/board.h"
#include "boards/i2c.h"
#include "boards/time_base.h"

#define SHIELD 1u
#define GYROSCOPE 0x20u
#define ACCELEROMETER 0x1Eu
#define SAMPLE_BYTES 6u
#define SAMPLES 300u
#define PERIOD_US 110000u /* 22 samples at 200 Hz */

typedef struct {
    uint8_t address;
    uint8_t status_register;
    uint8_t overflows;
    i2c_status_t status; /**< first that was not I2C_OK */
    uint32_t bytes;
    uint8_t samples[SAMPLES * SAMPLE_BYTES];
} fifo_t;

fifo_t fifos[2] = {{.address = GYROSCOPE, .status_register = 0x08u}, {.address = ACCELEROMETER, .status_register = 0x00u}};
volatile uint32_t finished;

static void put(fifo_t *fifo, uint8_t reg, uint8_t value)
{
    const i2c_status_t status = i2c_write(SHIELD, fifo->address, reg, &value, 1u);
    fifo->status = fifo->status == I2C_OK ? status : fifo->status;
}

static void drain(fifo_t *fifo)
{
    uint8_t state = 0u;
    fifo->status = fifo->status == I2C_OK ? i2c_read(SHIELD, fifo->address, fifo->status_register, &state, 1u) : fifo->status;
    const uint32_t left = sizeof fifo->samples - fifo->bytes;
    uint32_t count = (state & 0x3Fu) * SAMPLE_BYTES;
    count = count < left ? count : left;
    fifo->overflows = (uint8_t)(fifo->overflows + (state >> 7));
    if (fifo->status == I2C_OK && count > 0u) {
        fifo->status = i2c_read(SHIELD, fifo->address, 0x01u, &fifo->samples[fifo->bytes], (uint8_t)count);
        fifo->bytes += count;
    }
}

int main(void)
{
    board_start();
    uint64_t wake_us = 70000u; /* the gyroscope boots for 50 ms */
    sleep_until_us(wake_us);
    put(&fifos[0], 0x09u, 0x40u); /* circular */
    put(&fifos[0], 0x15u, 0x08u); /* 06 is followed by 01 */
    put(&fifos[0], 0x13u, 0x0Au); /* 200 Hz */
    put(&fifos[1], 0x09u, 0x40u);
    put(&fifos[1], 0x2Au, 0x11u); /* 200 Hz */
    while (fifos[0].bytes < sizeof fifos[0].samples || fifos[1].bytes < sizeof fifos[1].samples) {
        wake_us += PERIOD_US;
        sleep_until_us(wake_us);
        drain(&fifos[0]);
        drain(&fifos[1]);
    }
    finished = 1u;
    for (;;) {
        sleep_until_us(WAIT_FOREVER);
    }
}
