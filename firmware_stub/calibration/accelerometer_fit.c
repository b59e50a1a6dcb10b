#include "accelerometer_fit.h"

#include "fast_code.h"

/* 5 mg: noise is 1.3 mg rms, a hand that holds the board 10 and more. */
#define MOVED_SPREAD_COUNTS 40.96f

FAST_CODE bool accelerometer_moved(const still_pose_t *pose)
{
    const float *spread = pose->accelerometer_spread;
    return !(spread[0] <= MOVED_SPREAD_COUNTS && spread[1] <= MOVED_SPREAD_COUNTS && spread[2] <= MOVED_SPREAD_COUNTS);
}

FAST_CODE void accelerometer_no_fit(accelerometer_status_t status, uint8_t faces, uint8_t pose, accelerometer_fit_t *fit)
{
    fit->status = status;
    fit->faces = faces;
    fit->pose = pose;
    /* Not copied from accelerometer_nominal: that is a call of memcpy, which is in flash. */
    for (int i = 0; i < 9; i++) {
        fit->calibration.gain[i] = (i % 4 == 0) ? ACCELEROMETER_G_PER_COUNT : 0.0f;
    }
    for (int axis = 0; axis < 3; axis++) {
        fit->calibration.offset[axis] = 0.0f;
    }
}

float accelerometer_face_residual_mg(const still_poses_t *poses, const accelerometer_calibration_t *calibration)
{
    float sums[3][3] = {{0.0f}};
    float squares = 0.0f;
    for (uint8_t i = 0; i < poses->count; i++) {
        const uint8_t face = poses->poses[i].face;
        float gravity_g[3];
        accelerometer_apply(calibration, poses->poses[i].accelerometer, gravity_g);
        for (uint32_t axis = 0; axis < 3u && face < FACE_COUNT; axis++) {
            sums[face / 2u][axis] += gravity_g[axis];
        }
    }
    for (uint32_t pair = 0; pair < 3u; pair++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            squares += axis == pair ? 0.0f : sums[pair][axis] * sums[pair][axis];
        }
    }
    /* A sum of two has twice the variance of one, and there are six across. */
    return 1000.0f * __builtin_sqrtf(squares * (1.0f / 12.0f));
}

float accelerometer_norm_residual_mg(const still_poses_t *poses, const accelerometer_calibration_t *calibration)
{
    float squares = 0.0f;
    for (uint8_t i = 0; i < poses->count; i++) {
        float g[3];
        accelerometer_apply(calibration, poses->poses[i].accelerometer, g);
        const float error_g = __builtin_sqrtf(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) - 1.0f;
        squares += error_g * error_g;
    }
    return 1000.0f * __builtin_sqrtf(squares / (float)poses->count);
}
