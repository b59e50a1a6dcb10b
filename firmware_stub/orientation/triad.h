/**
 * @file triad.h
 * @brief The attitude that gravity and the magnetic field show by themselves (TRIAD).
 */
#ifndef HILTEST_TRIAD_H
#define HILTEST_TRIAD_H

#include <stdbool.h>

/**
 * Form the attitude: down along gravity, north where the field is.
 *
 * @param gravity body frame (x forward, y right, z down), positive down: level is (0, 0, +1); any scale
 * @param field corrected magnetic field in the body frame, any scale
 * @param[out] attitude unit quaternion x, y, z, w of either sign, body to north-east-down; stored only if there is one
 * @return false if a norm is not within 1e-6 to 1e6, or the vectors are parallel
 */
bool triad(const float gravity[3], const float field[3], float attitude[4]);

#endif
