/**
 * @file joint.h
 * @brief `joint`: the magnetometer calibrated by norms and by gravity at once, in Gauss-Newton steps from the fit of norms alone.
 *
 * With `f = K (m - k)`, its direction u and unit gravity g, every pair has two residuals: `|f| - 1`, and `g . u` less its mean, the sine
 * of the dip. 13 unknowns: K is no symmetric matrix, since it also rotates the field to the accelerometer's axes. `dpi` fits the product
 * `g . f` alone, in which the noise of the norm is most of the noise, and has nearly twice the error.
 *
 * A step changes f by Q (u, 1), Q a 3x4 matrix. Isotropic noise s of f makes s in `|f| - 1`, and `|p| s` in `g . u`, since that
 * changes by `p . Q (u, 1)` with `p = g - (g . u) u`. Weighted by it, the normal equations are
 *
 *     sum (|p|^2 u u' + p p') x (u, 1)(u, 1)' = sum (|p|^2 I - t t') x (u, 1)(u, 1)',     t = u x g,  |t| = |p|
 *     target: -sum h x (u, 1),     h = |p|^2 (|f| - 1) u + (g . u - mean) p
 *
 * less the part that the sine of the dip takes: `b b' / n`, b = sum p x (u, 1). The second form of the matrix has the sums of one vector
 * instead of two, and a quarter of them follows from `t . u = 0`.
 */
#ifndef HILTEST_JOINT_H
#define HILTEST_JOINT_H

#include "dpi.h"

/** Fewer are refused: with 100 the worst heading errs by as much as that of `dpi` with 300. */
#define JOINT_PAIRS_MINIMUM 100u

/**
 * Calibrate from pairs, at least JOINT_PAIRS_MINIMUM. A dip that is given decides about the sign only.
 *
 * @param[out] result the status of `direct-fast` if that refuses the points; FIT_TOO_FEW_POINTS; FIT_SINGULAR when the attitudes leave
 *             something undetermined; FIT_POOR_COVERAGE where the field is vertical, so that it has no heading; FIT_MIRRORED when no
 *             rotation makes the dot product the same in all attitudes, or its sign is that of another dip than the given one, as the wrong
 *             sign of gravity, or two swapped axes, make it; else FIT_ELLIPSOID, or FIT_NOT_CONVERGED after the last step. `iterations`
 *             counts steps; `standard_error` is that of a dot product of unit vectors.
 */
void joint_from_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, dpi_fit_t *result);

#endif
