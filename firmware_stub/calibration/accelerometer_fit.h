/**
 * @file accelerometer_fit.h
 * @brief Fits of an accelerometer calibration to still poses: what they share, and the two that there are.
 */
#ifndef HILTEST_ACCELEROMETER_FIT_H
#define HILTEST_ACCELEROMETER_FIT_H

#include <stdbool.h>

#include "accelerometer_calibration.h"
#include "still_pose.h"

/** Of `pose` when no pose is at fault. */
#define NO_POSE 255u

/** How a fit ended. The values are part of the link protocol. */
typedef enum {
    ACCELEROMETER_OK = 0,
    ACCELEROMETER_MISSING_FACE,
    ACCELEROMETER_REPEATED_FACE,
    ACCELEROMETER_MISPLACED_FACE, /**< another axis than the face's own is down, or none is, or the norm is far from 1 g */
    ACCELEROMETER_MOVED,          /**< readings spread more than those of a board that is still */
    ACCELEROMETER_TOO_FEW_POSES,
    ACCELEROMETER_POOR_COVERAGE,  /**< gravity came from too few sides */
    ACCELEROMETER_NOT_AN_ELLIPSOID,
} accelerometer_status_t;

/** Poses to fit. */
typedef struct {
    const still_pose_t *poses;
    uint8_t count;
} still_poses_t;

/** A calibration and how it came about. */
typedef struct {
    accelerometer_status_t status;
    uint8_t faces; /**< at fault: bit f is face f */
    uint8_t pose;  /**< index of the first pose at fault, or NO_POSE */
    accelerometer_calibration_t calibration; /**< the nominal one unless the status is OK */
} accelerometer_fit_t;

/**
 * Fit gain and offset to the six faces: norms decide both, the faces only how the axes are turned.
 *
 * Gravity is 1 g long however askew a face is: six norms determine three offsets and three scales. Half of what opposite faces
 * differ by across their axis is then the part's, and the middle of the two how askew they were by sigma. Both have the variance
 * sigma^2 / 2 of it, so the part's is taken with the weight c^2 / (c^2 + sigma^2 / 2), c = 0.005, and divided out of the readings
 * before the norms are met once more.
 *
 * @param poses each face once, of any order; poses that are no face are left out
 * @param[out] fit OK, MISSING_FACE, REPEATED_FACE, MISPLACED_FACE or MOVED: the first that is true of any face, with all it is true
 * of; or NOT_AN_ELLIPSOID
 */
void accelerometer_six_position(const still_poses_t *poses, accelerometer_fit_t *fit);

/**
 * Fit the ellipsoid of gravity's means, and the symmetric gain that makes it a sphere of 1 g.
 *
 * Coelho and Hemerly, eq. 5 and 6. Norms tell nothing of a rotation, and it is left in.
 *
 * @param poses at least 9, of any face or none
 * @param[out] fit OK, TOO_FEW_POSES, MOVED, POOR_COVERAGE or NOT_AN_ELLIPSOID
 */
void accelerometer_ellipsoid(const still_poses_t *poses, accelerometer_fit_t *fit);

/** Whether a pose's readings spread too much; a single reading cannot show that they do not. */
bool accelerometer_moved(const still_pose_t *pose);

/** Store a status without a fit. */
void accelerometer_no_fit(accelerometer_status_t status, uint8_t faces, uint8_t pose, accelerometer_fit_t *fit);

/** How askew the six faces were: rms of gravity's angle from its axis, about each of the two others [mrad, which are mg there]. Each
 * face is there once; poses that are no face are left out. */
float accelerometer_face_residual_mg(const still_poses_t *poses, const accelerometer_calibration_t *calibration);

/** The residual of a calibration: rms over all poses of the norm minus 1 g [mg]. */
float accelerometer_norm_residual_mg(const still_poses_t *poses, const accelerometer_calibration_t *calibration);

#endif
