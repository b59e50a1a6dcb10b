/**
 * @file sensors_fxos8700cq.c @brief The shield's FXOS8700CQ as both sensors of the compass; the part calibrates its hard iron itself.
 */
#include "boards/time_base.h"
#include "sensors.h"
#include "sensors/drivers.h"
#include "sensors/sampler.h"
#include "shield.h" /* its bus */

#define UT_PER_COUNT 0.1f
#define COUNTS_PER_G 8192.0f
#define LONGEST_WAIT_US 200000u

static const register_setting_t settings[] = {
    {0x2A, 0x00}, /* CTRL_REG1: standby */
    {0x09, 0x00}, /* F_SETUP: no FIFO */
    {0x0E, 0x01}, /* XYZ_DATA_CFG: 4 g */
    {0x2B, 0x02}, /* CTRL_REG2: high resolution */
    {0x5B, 0x9F}, /* M_CTRL_REG1: automatic hard-iron calibration, the most oversampling, both sensors */
    {0x5C, 0x04}, /* M_CTRL_REG2: the extremes of before are forgotten */
    {0x5D, 0x00}, /* M_CTRL_REG3: the output is without the hard iron */
    {0x2A, 0x15}, /* CTRL_REG1: both sensors at 100 Hz, low noise, active */
};
static sensor_driver_t driver;
static const sensor_t part = {"FXOS8700CQ", &driver, SHIELD, 0x1E};
static const sensor_t gravity_part = {"FXOS8700CQ", &fxos8700_accelerometer_driver, SHIELD, 0x1E};
static sampler_t sampler;

static bool fxos8700_set_up(void)
{
    uint8_t seen;
    driver = fxos8700_magnetometer_driver;
    driver.settings = settings;
    driver.setting_count = sizeof settings / sizeof settings[0];
    driver.period_us = 10000u;
    return sensor_probe(&part, &seen) == SENSOR_OK && sensor_configure(&part) == SENSOR_OK && sampler_start(&sampler, &part) == SENSOR_OK;
}

static bool field_read(float field_ut[3])
{
    sample_t sample;
    if (sampler_next(&sampler, &sample, time_us() + LONGEST_WAIT_US) != SENSOR_OK) {
        return false;
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        field_ut[axis] = UT_PER_COUNT * (float)sample.body[axis];
    }
    return true;
}

static bool is_set_up(void)
{
    return true; /* with the magnetometer */
}

static bool gravity_read(float gravity[3])
{
    int16_t counts[3];
    if (sensor_read_latest(&gravity_part, counts) != SENSOR_OK) {
        return false;
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        gravity[axis] = (float)counts[axis] / COUNTS_PER_G;
    }
    return true;
}

const compass_sensor_t magnetometer = {"FXOS8700CQ", fxos8700_set_up, field_read};
const compass_sensor_t accelerometer = {"FXOS8700CQ", is_set_up, gravity_read};
