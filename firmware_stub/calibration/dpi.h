/**
 * @file dpi.h
 * @brief `dpi`: the magnetometer calibrated against gravity, by the dot product that is the same in every attitude.
 *
 * Coelho and Hemerly 2014, eq. 8 and 9: `g . (K m - k) = |m| |g| sin(dip)`, gravity positive down: 12 unknowns, linear least
 * squares. It sees the rotation that no fit of norms can, as far as the accelerometer's own axes are right.
 *
 * The constant on the right scales K and k alone, so it is 1 here. Its sign is that which makes det K positive, its size that which
 * gives corrected points norm 1, or else the dip that the caller knows. The field's strength cancels.
 */
#ifndef HILTEST_DPI_H
#define HILTEST_DPI_H

#include "accelerometer_calibration.h"
#include "magnetometer_calibrator.h"
#include "still_pose.h"

/** Fewer are refused: of 100 single pairs, one set in a hundred makes a heading that errs by more than 2 degrees. */
#define DPI_PAIRS_MINIMUM 300u
#define DPI_POSES_MINIMUM 38u
/** Of every pose. */
#define DPI_POSE_READINGS 16u

/** Readings of both sensors, taken at the same instants [counts, body frame]. */
typedef struct {
    const int16_t (*magnetometer)[3];
    const int16_t (*accelerometer)[3];
    uint16_t count;
    int16_t minimum[3]; /**< smallest x, y, z of the magnetometer */
    int16_t maximum[3];
} dpi_pairs_t;

/** Means of both sensors at still poses. */
typedef struct {
    const still_pose_t *poses;
    uint16_t count;
} dpi_poses_t;

/** The facts that are known before the fit. */
typedef struct {
    accelerometer_calibration_t accelerometer;
    float sine;           /**< of the dip, positive where the field points down; not looked at unless it is given */
    uint8_t dip_is_given; /**< 0: the dip is estimated */
} dpi_known_t;

/** A calibration and what it rests on. */
typedef struct {
    magnetometer_fit_t fit; /**< FIT_ELLIPSOID when there is one: soft_iron is no symmetric matrix. No iterations. Coverage: largest
                                 pivot that attitudes all round would have over the one there is, the last left out */
    uint16_t used;          /**< rows of the least squares: all, or none was fitted */
    float sine;             /**< of the dip, as the data have it; 0 without a solution */
    float standard_error;   /**< of one row's dot product, in parts of the field's strength; float32 adds up to
                                 0.001: read it where the dip is in question, not for the noise */
} dpi_fit_t;

/**
 * Calibrate from pairs, at least DPI_PAIRS_MINIMUM.
 *
 * @param[out] result FIT_TOO_FEW_POINTS; FIT_SINGULAR when the attitudes leave something undetermined; FIT_HORIZONTAL_FIELD where
 *             |sin(dip)|, given or estimated, is under 5 standard errors; FIT_MIRRORED when the calibration would be a reflection,
 *             as the wrong sign of gravity or of the dip, or two swapped axes, make it; else FIT_ELLIPSOID
 */
void dpi_from_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, dpi_fit_t *result);

/** The same from still poses: at least DPI_POSES_MINIMUM, and none of fewer than DPI_POSE_READINGS; `used` counts those that have them. */
void dpi_from_poses(const dpi_poses_t *poses, const dpi_known_t *known, dpi_fit_t *result);

#endif
