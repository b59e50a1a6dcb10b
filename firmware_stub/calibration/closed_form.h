/**
 * @file closed_form.h
 * @brief From moments to a calibration without an iteration over points: what `direct` and `direct-stream` have in common.
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
 * Fit the quadric of unit trace and form the symmetric matrix and the offset that take its ellipsoid to the unit sphere.
 *
 * In a header so that each calibrator is compiled whole: a call would cost both some cycles, and they are compared by cycles.
 *
 * @param sums moments of at least FIT_ELLIPSOID_UNKNOWNS points about the anchor, which is near their middle
 * @param anchor [counts]
 * @param[out] fit all of it but the iterations
 */
static inline __attribute__((always_inline)) void
fit_closed_form(const moments_t *sums, const int32_t anchor[3], magnetometer_fit_t *fit)
{
    quadric_t quadric;
    ellipsoid_t ellipsoid;

    fit->coverage = quadric_fit(sums, &quadric);
    if (fit->coverage > COVERAGE_LIMIT) {
        fit_sphere(sums, anchor, FIT_POOR_COVERAGE, fit);
        return;
    }
    if (!quadric_ellipsoid(&quadric, &ellipsoid)) {
        fit_sphere(sums, anchor, FIT_NOT_AN_ELLIPSOID, fit);
        return;
    }
    fit->status = FIT_ELLIPSOID;
    fit->is_sphere = 0;
    for (int axis = 0; axis < 3; axis++) {
        fit->hard_iron[axis] = (float)anchor[axis] + ellipsoid.centre[axis];
    }
    symmetric_square_root(&quadric.shape, ellipsoid.minors, ellipsoid.root_determinant,
                          1.0f / __builtin_sqrtf(ellipsoid.level), fit->soft_iron);
}

#endif
