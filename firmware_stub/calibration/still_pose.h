/**
 * @file still_pose.h
 * @brief The readings of magnetometer and accelerometer while the board stood still.
 */
#ifndef HILTEST_STILL_POSE_H
#define HILTEST_STILL_POSE_H

#include <stdint.h>

#define FACE_COUNT 6u
/** A pose that is none of the six faces. */
#define FACE_NONE 255u

/** Means and sample standard deviations of new samples of each sensor [counts, body frame]. */
typedef struct {
    float magnetometer[3];
    float magnetometer_spread[3]; /**< NaN for a single sample, as the other one */
    float accelerometer[3];
    float accelerometer_spread[3];
    uint16_t readings; /**< of each sensor */
    uint8_t face;      /**< which axis was to be down: 0 to 5 are +x, -x, +y, -y, +z, -z; or FACE_NONE */
} still_pose_t;

#endif
