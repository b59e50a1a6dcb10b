/**
 * @file tilt_heading.h
 * @brief Tilt-compensated compass: attitude from gravity and the magnetic field.
 */
#ifndef HILTEST_TILT_HEADING_H
#define HILTEST_TILT_HEADING_H

typedef enum {
    TILT_OK = 0,
    TILT_DEGENERATE_FIELD, /**< gravity or field is zero, not finite, or they are parallel: no heading */
} tilt_status_t;

/**
 * Compute heading, pitch and roll: the yaw, pitch and roll of z-y'-x'' rotations from north-east-down to the body.
 *
 * At pitch +-90 degrees only heading minus or plus roll is determined; roll is then taken as 0.
 *
 * @param gravity direction of gravity in the body frame (x forward, y right, z down), any scale; level is (0, 0, +)
 * @param field corrected magnetic field in the body frame, any scale
 * @param[out] heading_deg from magnetic north, clockwise, 0 <= heading < 360
 * @param[out] pitch_deg nose up positive, -90..90
 * @param[out] roll_deg right side down positive, -180..180
 * @return TILT_OK; otherwise nothing is stored
 */
tilt_status_t tilt_heading(const float gravity[3], const float field[3], float *heading_deg, float *pitch_deg,
                           float *roll_deg);

#endif
