/** @file shield_accelerometer.c @brief The accelerometer of the shield's FXOS8700CQ. */
#include "sensors.h"
#include "sensors/drivers.h"
#include "shield.h"

#define COUNTS_PER_G 8192.0f

static const sensor_t part = {"FXOS8700CQ", &fxos8700_accelerometer_driver, SHIELD, 0x1E};

bool shield_set_up(const sensor_t *sensor)
{
    uint8_t seen;
    return sensor_probe(sensor, &seen) == SENSOR_OK && sensor_configure(sensor) == SENSOR_OK;
}

static bool fxos8700_set_up(void)
{
    return shield_set_up(&part);
}

static bool fxos8700_read(float gravity[3])
{
    int16_t counts[3];
    if (sensor_read_latest(&part, counts) != SENSOR_OK) {
        return false;
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        gravity[axis] = (float)counts[axis] / COUNTS_PER_G;
    }
    return true;
}

const compass_sensor_t accelerometer = {"FXOS8700CQ", fxos8700_set_up, fxos8700_read};
