#include "accelerometer_calibration.h"

const accelerometer_calibration_t accelerometer_nominal = {
    .gain = {ACCELEROMETER_G_PER_COUNT, 0.0f, 0.0f, 0.0f, ACCELEROMETER_G_PER_COUNT, 0.0f, 0.0f, 0.0f,
             ACCELEROMETER_G_PER_COUNT},
};

void accelerometer_apply(const accelerometer_calibration_t *calibration, const float counts[3], float gravity_g[3])
{
    const float *row = calibration->gain;
    const float x = counts[0] - calibration->offset[0];
    const float y = counts[1] - calibration->offset[1];
    const float z = counts[2] - calibration->offset[2];
    for (int axis = 0; axis < 3; axis++) {
        gravity_g[axis] = row[0] * x + row[1] * y + row[2] * z;
        row += 3;
    }
}
