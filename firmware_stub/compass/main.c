/**
 * @file main.c @brief A compass as a product would be one: it says its heading ten times a second, and calibrates itself in use.
 *
 * To make it yours: write drivers of your sensors (sensors.h), take another calibrator in background.c, say other things in
 * output_lines.c.
 */
#include <math.h>
#include <stddef.h>

#include "boards/board.h"
#include "boards/time_base.h"
#include "compass.h"
#include "orientation/tilt_heading.h"
#include "sensors.h"
#include "sensors/sensor.h"
#include "store.h"

#define SAMPLES_A_STATE 8 /* of 80 to 100 a second; their mean has a third of the noise */

static background_t background = BACKGROUND_START;
static bool has_gyroscope;

static bool set_up(const compass_sensor_t *sensor)
{
    if (sensor->set_up()) {
        return true;
    }
    output_error(sensor->name);
    return false;
}

/** Say what the sums over some samples mean. */
static void say(const float field_ut[3], const float gravity[3])
{
    compass_state_t state = {.time_us = (uint32_t)time_us()};
    for (uint32_t axis = 0; axis < 3u; axis++) {
        state.raw[axis] = field_ut[axis] / (UT_PER_COUNT * (float)SAMPLES_A_STATE);
        state.gravity[axis] = gravity[axis] / (float)SAMPLES_A_STATE;
    }
    iron_remove(&background.iron, state.raw, state.field);
    state.has_heading = tilt_heading(state.gravity, state.field, &state.heading_deg, &state.pitch_deg, &state.roll_deg) == TILT_OK;
    state.has_rate = has_gyroscope && gyroscope.read(state.rate_dps);
    output_state(&state, &background);
}

/** Take the samples of one state, calibrating meanwhile, and say it. False when a sensor fails. */
static bool measure(void)
{
    float field_sum[3] = {0.0f, 0.0f, 0.0f}, gravity_sum[3] = {0.0f, 0.0f, 0.0f};
    for (int taken = 0; taken < SAMPLES_A_STATE; taken++) {
        float field_ut[3], gravity[3];
        int16_t point[3];
        if (!magnetometer.read(field_ut) || !accelerometer.read(gravity)) {
            return false;
        }
        for (uint32_t axis = 0; axis < 3u; axis++) {
            field_sum[axis] += field_ut[axis];
            gravity_sum[axis] += gravity[axis];
            point[axis] = (int16_t)lrintf(field_ut[axis] / UT_PER_COUNT); /* sensors of a compass stay below 3276 uT */
        }
        background_take(&background, point);
    }
    say(field_sum, gravity_sum);
    return true;
}

/** Save the calibration when the line SAVE asks for it. */
static void obey(void)
{
    if (typed_line_is("SAVE")) {
        if (background.iron.strength == 0.0f) {
            output_error("SAVE: not calibrated yet");
        } else if (store_save(&background.iron)) {
            output_answer("SAVED");
        } else {
            output_error("SAVE: the flash did not take it");
        }
    }
}

int main(void)
{
    board_start();
    sleep_until_us(SENSOR_BOOT_US);
    (void)store_load(&background.iron);
    for (;;) {
        has_gyroscope = gyroscope.set_up != NULL && set_up(&gyroscope);
        if (set_up(&magnetometer) && set_up(&accelerometer)) {
            while (measure()) {
                obey();
            }
            output_error("a sensor fell silent");
        }
        sleep_until_us(time_us() + 1000000u); /* before they are set up again */
    }
}
