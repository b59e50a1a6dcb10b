/**
 * @file accelerometer_commands.c
 * @brief SET_ACCELEROMETER, GET_ACCELEROMETER and FIT_ACCELEROMETER.
 */
#include <string.h>

#include "calibration/accelerometer_fit.h"
#include "calibration/fast_code.h"
#include "calibration_slots.h"
#include "command.h"
#include "linear_fields.h"
#include "pose_buffer.h"
#include "timed_run.h"

status_t command_set_accelerometer(payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    accelerometer_calibration_t calibration;
    const uint8_t slot = read_u8(request);
    const bool is_finite = read_linear(request, calibration.gain, calibration.offset);
    if (slot >= SLOT_COUNT || !is_finite) {
        return STATUS_BAD_ARGUMENT;
    }
    slot_set_accelerometer(slot, &calibration);
    return STATUS_OK;
}

status_t command_get_accelerometer(payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t slot = read_u8(request);
    if (slot >= SLOT_COUNT) {
        return STATUS_BAD_ARGUMENT;
    }
    const accelerometer_calibration_t *calibration = slot_accelerometer(slot);
    write_linear(reply, calibration->gain, calibration->offset);
    return STATUS_OK;
}

static FAST_CODE void fit_six_position(const void *poses, void *fit)
{
    accelerometer_six_position(poses, fit);
}

static FAST_CODE void fit_accelerometer_ellipsoid(const void *poses, void *fit)
{
    accelerometer_ellipsoid(poses, fit);
}

typedef struct {
    const char *name;
    timed_work_t fit;
    float (*residual_mg)(const still_poses_t *poses, const accelerometer_calibration_t *calibration);
} method_t;

static const method_t methods[] = {
    {"six-position", fit_six_position, accelerometer_face_residual_mg},
    {"ellipsoid", fit_accelerometer_ellipsoid, accelerometer_norm_residual_mg},
};

static const method_t *find_method(const char *name, uint8_t length)
{
    for (size_t i = 0; i < sizeof methods / sizeof methods[0]; i++) {
        if (strlen(methods[i].name) == length && memcmp(methods[i].name, name, length) == 0) {
            return &methods[i];
        }
    }
    return NULL;
}

status_t command_fit_accelerometer(payload_reader_t *request, payload_writer_t *reply)
{
    const still_poses_t poses = {.poses = poses_stored(), .count = read_u8(request)};
    uint8_t name_length = 0;
    const char *name = read_string(request, &name_length);
    if (!reader_is_exhausted(request)) {
        return STATUS_BAD_LENGTH;
    }
    const method_t *method = find_method(name, name_length);
    if (method == NULL) {
        return STATUS_UNKNOWN_CALIBRATOR;
    }
    if (poses.count > poses_count()) {
        return STATUS_TOO_FEW_POINTS;
    }
    accelerometer_fit_t fit;
    const run_cost_t cost = timed_work(method->fit, &poses, &fit);
    write_u8(reply, (uint8_t)fit.status);
    write_u8(reply, fit.faces);
    write_u8(reply, fit.pose);
    write_linear(reply, fit.calibration.gain, fit.calibration.offset);
    write_f32(reply, fit.status == ACCELEROMETER_OK ? method->residual_mg(&poses, &fit.calibration) : 0.0f);
    write_u32(reply, cost.cycles);
    write_u32(reply, cost.overhead_cycles);
    return timed_run_has_counter() ? STATUS_OK : STATUS_NO_CYCLE_COUNTER;
}
