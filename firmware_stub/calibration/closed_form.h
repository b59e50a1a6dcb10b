/**
 * @file closed_form.h
 * @brief From moments to a calibration without an iteration over points: what `direct`, `corrected` and `direct-stream` share.
 *
 * No calibration that may be worse than none is handed out: its error is predicted, also for calibrators that iterate.
 *
 * The equations are those of direct.c: normal_equations.h solves eq. 44 of the thesis, quadric.h finds centre and level, square_root.h
 * the symmetric root.
 */
#ifndef HILTEST_CLOSED_FORM_H
#define HILTEST_CLOSED_FORM_H

#include "fit_result.h"
#include "normal_equations.h"

/* Largest M_ii/d_i on the mid-range anchor of points that packed sums or Newton steps can carry: at most 1.7 for a full sphere, 6 to 30
 * for half of one, 31 to 158 for 30 % of one (simulated at 0.4 uT). */
#define COVERAGE_LIMIT 30.0f

/* A fit whose predicted rms error of directions is larger is refused; the host has the same number, as a test checks. */
#define LARGEST_DIRECTION_ERROR_DEG 5.0f

/* Part of the bias of least squares that is counted: all of it, but a quarter for `corrected`, which removes it. Of its fits with 1000
 * points, 1 uT and up to 90 % of the sphere missing 18 of 280 erred by more than 5 degrees if none was counted, and 1 if a quarter was. */
#define BIAS_OF_LEAST_SQUARES 1.0f
#define BIAS_LEFT 0.25f

/**
 * Fit the quadric of unit trace, and refuse it if it may be worse than no calibration.
 *
 * The rms angle between directions by the ellipsoid and the true ones, over the sphere, is predicted. With A near a third of the
 * identity, an error (dA, dg, dj) turns directions by the mean square `9/20 |dA|^2 + |dg + 2 dA centre|^2 / (2 level)`. Its covariance
 * is that of least squares: the inverse of the normal matrix times the variance of D, by generalised cross-validation (Golub, Heath and
 * Wahba, Technometrics 21, 1979) n sum D^2 / (n - 9)^2. Of that inverse, whose factors are 1/d and rows of the inverse of L, the last
 * row is used whole, since it has the combination of unknowns that a part of the sphere determines worst, and of the others only the
 * diagonal. The last row also has the bias that noise makes. Nine points leave no residual, and are refused.
 *
 * @param sums moments of at least FIT_ELLIPSOID_UNKNOWNS points about an anchor near their middle
 * @param bias_share part of the bias that the calibration has which the points are used for
 * @param[out] solution its quadric
 * @param[out] ellipsoid of the solution
 * @param[out] fit its coverage; if it is refused, all but the iterations
 * @return whether there is an ellipsoid with a predicted error of at most LARGEST_DIRECTION_ERROR_DEG
 */
bool fit_ellipsoid(const moments_t *sums, float bias_share, solution_t *solution, ellipsoid_t *ellipsoid, magnetometer_fit_t *fit);

/**
 * Predict the rms angle between directions by an ellipsoid and the true ones, over the sphere, and compare it with the largest.
 *
 * @param sums moments that the quadric was fitted to
 * @param residual sum D^2 over the points, with their noise [counts^4]
 * @param bias_share see `fit_ellipsoid`
 * @param solution the quadric, and what its normal equations leave undetermined
 * @param ellipsoid of the solution
 * @return whether the prediction is at most LARGEST_DIRECTION_ERROR_DEG
 */
bool fit_is_accurate(const moments_t *sums, float residual, float bias_share, const solution_t *solution, const ellipsoid_t *ellipsoid);

/**
 * Store the symmetric matrix and the offset that take an ellipsoid to the unit sphere.
 *
 * @param quadric what the ellipsoid is of
 * @param ellipsoid see there
 * @param anchor [counts]
 * @param status of the fit
 * @param[out] fit coverage and iterations are left alone
 */
void fit_calibration(const quadric_t *quadric, const ellipsoid_t *ellipsoid, const int32_t anchor[3], fit_status_t status,
                     magnetometer_fit_t *fit);

/** Fit the quadric of unit trace, and calibrate by its ellipsoid, or refuse it: all of `fit` but the iterations. */
void fit_closed_form(const moments_t *sums, const int32_t anchor[3], magnetometer_fit_t *fit);

#endif
