/**
 * @file main.c @brief A compass as a product would be one: it says its heading ten times a second, and calibrates itself in use.
 *
 * To make it yours: name your sensors below, take another calibrator in background.c, say other things in output_lines.c.
 */
#include "boards/board.h"
#include "boards/time_base.h"
#include "compass.h"
#include "orientation/tilt_heading.h"
#include "sensors/drivers.h"
#include "sensors/sampler.h"

#define SHIELD 1u         /* I2C bus */
#define SAMPLES_A_STATE 8 /* of 80 a second; their mean has a third of the noise */

static const sensor_t magnetometer = {"MAG3110", &mag3110_driver, SHIELD, 0x0E};
static const sensor_t accelerometer = {"FXOS8700CQ", &fxos8700_accelerometer_driver, SHIELD, 0x1E};
static background_t background = BACKGROUND_START;

static bool set_up(const sensor_t *sensor)
{
    uint8_t seen;
    if (sensor_probe(sensor, &seen) == SENSOR_OK && sensor_configure(sensor) == SENSOR_OK) {
        return true;
    }
    output_error(sensor->name);
    return false;
}

/** Say what the sums over some samples mean. */
static void say(const int32_t field[3], const int32_t gravity[3])
{
    compass_state_t state = {.time_us = (uint32_t)time_us()};
    for (uint32_t axis = 0; axis < 3u; axis++) {
        state.raw[axis] = (float)field[axis] / (float)SAMPLES_A_STATE;
        state.gravity[axis] = (float)gravity[axis] / (8192.0f * (float)SAMPLES_A_STATE); /* counts a g */
    }
    iron_remove(&background.iron, state.raw, state.field);
    state.has_heading = tilt_heading(state.gravity, state.field, &state.heading_deg, &state.pitch_deg, &state.roll_deg) == TILT_OK;
    output_state(&state, &background);
}

/** Take the samples of one state, calibrating meanwhile, and say it. False when a sensor fails. */
static bool measure(sampler_t *sampler)
{
    int32_t field_sum[3] = {0, 0, 0}, gravity_sum[3] = {0, 0, 0};
    for (int taken = 0; taken < SAMPLES_A_STATE; taken++) {
        sample_t field;
        int16_t gravity[3];
        if (sampler_next(sampler, &field, time_us() + 200000u) != SENSOR_OK
            || sensor_read_latest(&accelerometer, gravity) != SENSOR_OK) {
            return false;
        }
        for (uint32_t axis = 0; axis < 3u; axis++) {
            field_sum[axis] += field.body[axis];
            gravity_sum[axis] += gravity[axis];
        }
        background_take(&background, field.body);
    }
    say(field_sum, gravity_sum);
    return true;
}

int main(void)
{
    board_start();
    sleep_until_us(SENSOR_BOOT_US);
    for (;;) {
        sampler_t sampler;
        if (set_up(&magnetometer) && set_up(&accelerometer) && sampler_start(&sampler, &magnetometer) == SENSOR_OK) {
            while (measure(&sampler)) {
            }
            output_error("a sensor fell silent");
        }
        sleep_until_us(time_us() + 1000000u); /* before they are set up again */
    }
}
