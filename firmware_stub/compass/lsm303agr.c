/** @file lsm303agr.c @brief The two dies of an LSM303AGR on I2C, its magnetometer with the data-ready pin wired. */
#include "boards/i2c.h"
#include "data_ready.h"
#include "sensors.h"

#define BUS 0u
#define NEXT 0x80u /* the address moves on */

#define MAGNETOMETER 0x1Eu
#define WHO_AM_I_M 0x4Fu
#define IDENTITY_M 0x40u
#define CFG_REG_A_M 0x60u
#define OUTX_L_REG_M 0x68u
#define UT_PER_COUNT_M 0.15f
#define LONGEST_WAIT_US 50000u /* five samples */

#define ACCELEROMETER 0x19u
#define WHO_AM_I_A 0x0Fu
#define IDENTITY_A 0x33u
#define CTRL_REG1_A 0x20u
#define OUT_X_L_A 0x28u
#define G_PER_COUNT (0.00098f / 16.0f) /* left-justified words of 12 bits, at 2 g; +1 g on an axis that points up */

/* The compass points where x does, with z up: y is left then. Both dies have these axes. */
static int16_t word(const uint8_t bytes[2])
{
    return (int16_t)(uint16_t)(bytes[0] | bytes[1] << 8);
}

static bool is_there(uint8_t address, uint8_t who_am_i, uint8_t identity)
{
    uint8_t seen;
    return i2c_read(BUS, address, who_am_i, &seen, 1u) == I2C_OK && seen == identity;
}

static bool lsm303agr_magnetometer_set_up(void)
{
    /* CFG_REG_A_M to C: temperature compensation and 100 Hz, low-pass filter and offset cancellation, words as a whole, and new data on the pin. */
    static const uint8_t settings[] = {0x8C, 0x03, 0x11};
    return is_there(MAGNETOMETER, WHO_AM_I_M, IDENTITY_M)
           && i2c_write(BUS, MAGNETOMETER, CFG_REG_A_M | NEXT, settings, sizeof settings) == I2C_OK;
}

static bool lsm303agr_magnetometer_read(float field_ut[3])
{
    uint8_t bytes[6];
    if (!data_ready_wait(LONGEST_WAIT_US) || i2c_read(BUS, MAGNETOMETER, OUTX_L_REG_M | NEXT, bytes, sizeof bytes) != I2C_OK) {
        return false;
    }
    field_ut[0] = UT_PER_COUNT_M * (float)word(&bytes[0]);
    field_ut[1] = -UT_PER_COUNT_M * (float)word(&bytes[2]);
    field_ut[2] = -UT_PER_COUNT_M * (float)word(&bytes[4]);
    return true;
}

static bool lsm303agr_accelerometer_set_up(void)
{
    /* CTRL_REG1_A to 4: 200 Hz with all axes, no filter, no interrupt, words as a whole at 2 g in high resolution. */
    static const uint8_t settings[] = {0x67, 0x00, 0x00, 0x88};
    return is_there(ACCELEROMETER, WHO_AM_I_A, IDENTITY_A)
           && i2c_write(BUS, ACCELEROMETER, CTRL_REG1_A | NEXT, settings, sizeof settings) == I2C_OK;
}

static bool lsm303agr_accelerometer_read(float gravity[3])
{
    uint8_t bytes[6];
    if (i2c_read(BUS, ACCELEROMETER, OUT_X_L_A | NEXT, bytes, sizeof bytes) != I2C_OK) {
        return false;
    }
    gravity[0] = -G_PER_COUNT * (float)word(&bytes[0]); /* gravity is opposite to the force that holds the board */
    gravity[1] = G_PER_COUNT * (float)word(&bytes[2]);
    gravity[2] = G_PER_COUNT * (float)word(&bytes[4]);
    return true;
}

const compass_sensor_t magnetometer = {"LSM303AGR magnetometer", lsm303agr_magnetometer_set_up, lsm303agr_magnetometer_read};
const compass_sensor_t accelerometer = {"LSM303AGR accelerometer", lsm303agr_accelerometer_set_up, lsm303agr_accelerometer_read};
