/**
 * @file magnetometer_lis3mdl.c @brief A LIS3MDL on the shield's I2C bus, with its x forward, y left and z up: a driver of one's own.
 */
#include "boards/i2c.h"
#include "boards/time_base.h"
#include "sensors.h"
#include "shield.h"

#define ADDRESS 0x1Cu
#define WHO_AM_I 0x0Fu
#define IDENTITY 0x3Du
#define CTRL_REG1 0x20u
#define STATUS_REG 0x27u /* the data follow it */
#define NEXT 0x80u       /* the address moves on */
#define NEW_DATA 0x08u
#define COUNTS_PER_UT 68.42f /* at +-4 gauss */
#define PERIOD_US 12500u
#define LOOKS_A_PERIOD 8u

static bool lis3mdl_set_up(void)
{
    /* CTRL_REG1 to 5: ultra-high performance at 80 Hz, 4 gauss, continuous, z likewise, both bytes of one sample. */
    static const uint8_t settings[] = {0x7C, 0x00, 0x00, 0x0C, 0x40};
    uint8_t identity;
    return i2c_read(SHIELD, ADDRESS, WHO_AM_I, &identity, 1u) == I2C_OK && identity == IDENTITY
           && i2c_write(SHIELD, ADDRESS, CTRL_REG1 | NEXT, settings, sizeof settings) == I2C_OK;
}

static float microtesla(const uint8_t bytes[2])
{
    return (float)(int16_t)(uint16_t)(bytes[0] | bytes[1] << 8) / COUNTS_PER_UT;
}

static bool lis3mdl_read(float field_ut[3])
{
    for (uint32_t look = 0; look < 2u * LOOKS_A_PERIOD; look++) {
        uint8_t bytes[7];
        if (i2c_read_if(SHIELD, ADDRESS, STATUS_REG | NEXT, NEW_DATA, bytes, sizeof bytes) != I2C_OK) {
            return false;
        }
        if (bytes[0] & NEW_DATA) {
            field_ut[0] = microtesla(&bytes[1]);
            field_ut[1] = -microtesla(&bytes[3]);
            field_ut[2] = -microtesla(&bytes[5]);
            return true;
        }
        sleep_until_us(time_us() + PERIOD_US / LOOKS_A_PERIOD);
    }
    return false;
}

const compass_sensor_t magnetometer = {"LIS3MDL", lis3mdl_set_up, lis3mdl_read};
