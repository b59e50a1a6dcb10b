/**
 * @file accelerometer_calibration.h
 * @brief The type of an accelerometer calibration, and its application.
 */
#ifndef HILTEST_ACCELEROMETER_CALIBRATION_H
#define HILTEST_ACCELEROMETER_CALIBRATION_H

/** `gravity = gain * (counts - offset)`, body frame, gravity-positive: a level board has (0, 0, +1). */
typedef struct {
    float gain[9];   /**< row-major 3x3 [g/count] */
    float offset[3]; /**< [counts] */
} accelerometer_calibration_t;

/** By the data sheet, at 4 g full scale. */
#define ACCELEROMETER_G_PER_COUNT (1.0f / 8192.0f)

/** The part as its data sheet has it: no offset, no gain error. */
extern const accelerometer_calibration_t accelerometer_nominal;

/** Apply a calibration to counts; `gravity_g` gets the corrected gravity, of norm 1 while the board is still. */
void accelerometer_apply(const accelerometer_calibration_t *calibration, const float counts[3], float gravity_g[3]);

#endif
