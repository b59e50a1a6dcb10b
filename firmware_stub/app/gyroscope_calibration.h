/**
 * @file gyroscope_calibration.h
 * @brief The calibration of the gyroscope that the board holds: `rate_dps = matrix * (counts - bias)`.
 */
#ifndef HILTEST_GYROSCOPE_CALIBRATION_H
#define HILTEST_GYROSCOPE_CALIBRATION_H

typedef struct {
    float matrix[9]; /**< row-major 3x3 [deg/s/count] */
    float bias[3];   /**< [counts] */
} gyroscope_calibration_t;

/** The calibration of the board: after a reset 1/16 deg/s a count, as the data sheet says, and no bias. */
const gyroscope_calibration_t *gyroscope_calibration(void);

void gyroscope_calibration_set(const gyroscope_calibration_t *calibration);

/** Store a bias [counts], and leave the matrix alone. */
void gyroscope_bias_set(const float bias[3]);

/** Rate about the body axes [deg/s] of a reading [counts]. */
void gyroscope_rate(const gyroscope_calibration_t *calibration, const float counts[3], float rate_dps[3]);

#endif
