/**
 * @file average_commands.c
 * @brief AVERAGE.
 */
#include <math.h>

#include "boards/time_base.h"
#include "calibration_slots.h"
#include "command.h"
#include "orientation/tilt_heading.h"
#include "sample_series.h"
#include "sensor_set.h"

#define AVERAGE_MAXIMUM 512u

/** Heading, pitch and roll under a slot's two calibrations; NaN with the status that says why there are none. */
static void write_attitude(payload_writer_t *reply, uint8_t slot, const float acceleration[3], const float field[3])
{
    const calibration_t *calibration = slot_get(slot);
    float angles_deg[3] = {NAN, NAN, NAN};
    status_t status = STATUS_NO_CALIBRATION;
    if (calibration != NULL) {
        float unit[3];
        float gravity_g[3];
        calibration_apply(calibration, field, unit);
        accelerometer_apply(slot_accelerometer(slot), acceleration, gravity_g);
        status = STATUS_OK;
        if (tilt_heading(gravity_g, unit, &angles_deg[0], &angles_deg[1], &angles_deg[2]) != TILT_OK) {
            status = STATUS_DEGENERATE_FIELD;
            angles_deg[0] = angles_deg[1] = angles_deg[2] = NAN;
        }
    }
    write_u8(reply, (uint8_t)status);
    write_f32_array(reply, angles_deg, 3);
}

status_t command_average(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t count = read_u16(request);
    const uint32_t timeout_us = read_u32(request);
    const uint16_t slots = read_u16(request);
    if (count == 0u || count > AVERAGE_MAXIMUM || timeout_us > TIMEOUT_MAXIMUM_US) {
        return STATUS_BAD_ARGUMENT;
    }
    series_t series[ATTITUDE_KINDS];
    const status_t status = series_fill(series, count, time_us() + timeout_us);
    if (status != STATUS_OK) {
        return status;
    }
    write_series(reply, series, count);
    float field[3];
    float acceleration[3];
    statistics_mean(&series[SENSOR_MAGNETOMETER].statistics, field);
    statistics_mean(&series[SENSOR_ACCELEROMETER].statistics, acceleration);
    for (uint8_t slot = 0; slot < SLOT_COUNT; slot++) {
        if ((slots >> slot & 1u) != 0u) {
            write_attitude(reply, slot, acceleration, field);
        }
    }
    return STATUS_OK;
}
