/**
 * @file closed_form.h
 * @brief From moments to a calibration without an iteration over points: what `direct`, `corrected` and `direct-stream` share.
 *
 * The equations are those of direct.c: normal_equations.h solves eq. 44 of the thesis, quadric.h finds centre and level, square_root.h
 * the symmetric root.
 *
 * In a header so that each calibrator is compiled whole: a call would cost each some cycles, and they are compared by cycles.
 */
#ifndef HILTEST_CLOSED_FORM_H
#define HILTEST_CLOSED_FORM_H

#include "fit_result.h"
#include "normal_equations.h"
#include "square_root.h"

/* Largest M_ii/d_i on the mid-range anchor: at most 1.7 for a full sphere, 6 to 30 for half of one, 31 to 158 for 30 % of one
 * (simulated at 0.4 uT). Beyond this the ellipsoid follows the noise, not the field. */
#define COVERAGE_LIMIT 30.0f

/**
 * Fit the quadric of unit trace.
 *
 * @param sums moments of at least FIT_ELLIPSOID_UNKNOWNS points about the anchor, which is near their middle
 * @param anchor [counts]
 * @param[out] quadric the solution
 * @param[out] ellipsoid what the solution is
 * @param[out] fit its coverage; all but the iterations when there is no ellipsoid
 * @return whether there is one
 */
static inline __attribute__((always_inline)) bool fit_ellipsoid(const moments_t *sums, const int32_t anchor[3], quadric_t *quadric,
                                                                ellipsoid_t *ellipsoid, magnetometer_fit_t *fit)
{
    fit->coverage = quadric_fit(sums, quadric);
    if (fit->coverage > COVERAGE_LIMIT) {
        fit_sphere(sums, anchor, FIT_POOR_COVERAGE, fit);
        return false;
    }
    if (!quadric_ellipsoid(quadric, ellipsoid)) {
        fit_sphere(sums, anchor, FIT_NOT_AN_ELLIPSOID, fit);
        return false;
    }
    return true;
}

/**
 * Store the symmetric matrix and the offset that take an ellipsoid to the unit sphere.
 *
 * @param quadric what the ellipsoid is of
 * @param ellipsoid see there
 * @param anchor [counts]
 * @param status of the fit
 * @param[out] fit coverage and iterations are left alone
 */
static inline __attribute__((always_inline)) void fit_calibration(const quadric_t *quadric, const ellipsoid_t *ellipsoid,
                                                                  const int32_t anchor[3], fit_status_t status,
                                                                  magnetometer_fit_t *fit)
{
    fit->status = status;
    fit->is_sphere = 0;
    for (int axis = 0; axis < 3; axis++) {
        fit->hard_iron[axis] = (float)anchor[axis] + ellipsoid->centre[axis];
    }
    symmetric_square_root(&quadric->shape, ellipsoid->minors, ellipsoid->determinant, 1.0f / __builtin_sqrtf(ellipsoid->level),
                          fit->soft_iron);
}

/** Fit the quadric of unit trace, and calibrate by its ellipsoid or by the sphere: all of `fit` but the iterations. */
static inline __attribute__((always_inline)) void
fit_closed_form(const moments_t *sums, const int32_t anchor[3], magnetometer_fit_t *fit)
{
    quadric_t quadric;
    ellipsoid_t ellipsoid;

    if (fit_ellipsoid(sums, anchor, &quadric, &ellipsoid, fit)) {
        fit_calibration(&quadric, &ellipsoid, anchor, FIT_ELLIPSOID, fit);
    }
}

#endif
