#include "gyroscope_calibration.h"

#define DPS_PER_COUNT 0.0625f /* 2000 deg/s full scale, data sheet FXAS21002C */

static gyroscope_calibration_t held = {
    .matrix = {DPS_PER_COUNT, 0.0f, 0.0f, 0.0f, DPS_PER_COUNT, 0.0f, 0.0f, 0.0f, DPS_PER_COUNT},
};

const gyroscope_calibration_t *gyroscope_calibration(void)
{
    return &held;
}

void gyroscope_calibration_set(const gyroscope_calibration_t *calibration)
{
    held = *calibration;
}

void gyroscope_bias_set(const float bias[3])
{
    for (int axis = 0; axis < 3; axis++) {
        held.bias[axis] = bias[axis];
    }
}

void gyroscope_rate(const gyroscope_calibration_t *calibration, const float counts[3], float rate_dps[3])
{
    const float x = counts[0] - calibration->bias[0];
    const float y = counts[1] - calibration->bias[1];
    const float z = counts[2] - calibration->bias[2];
    for (int axis = 0; axis < 3; axis++) {
        const float *row = &calibration->matrix[3 * axis];
        rate_dps[axis] = row[0] * x + row[1] * y + row[2] * z;
    }
}
