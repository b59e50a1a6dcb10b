/** @file magnetometer_mag3110.c @brief The shield's MAG3110, by hiltest's driver and sampler. */
#include "boards/time_base.h"
#include "sensors.h"
#include "sensors/drivers.h"
#include "sensors/sampler.h"
#include "shield.h"

#define UT_PER_COUNT 0.1f
#define LONGEST_WAIT_US 200000u

static const sensor_t part = {"MAG3110", &mag3110_driver, SHIELD, 0x0E};
static sampler_t sampler;

static bool mag3110_set_up(void)
{
    return shield_set_up(&part) && sampler_start(&sampler, &part) == SENSOR_OK;
}

static bool mag3110_read(float field_ut[3])
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

const compass_sensor_t magnetometer = {"MAG3110", mag3110_set_up, mag3110_read};
