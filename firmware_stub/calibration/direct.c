/**
 * @file direct.c
 * @brief `direct`: the algebraic ellipsoid fit in closed form, without iterations over the points and without eigenvalues.
 *
 * Mucciaccia's thesis (2020), section 3.2. Least squares of the algebraic distance to the quadric of unit trace, eq. 36 to 39,
 * by the normal equations, eq. 43 to 48; then the symmetric matrix and the offset that take that ellipsoid to the unit sphere, eq. 49
 * to 65. Some equations are wrong as printed, and corrected here:
 *  - eq. 45: M99 is 2N; eq. 46 is summed over the points. The factor 2 on both sides is left out.
 *  - eq. 53 to 64: with the centre `x0 = -A^-1 g / 2` and the level `k = x0' A x0 - j`, soft iron is `A^(1/2) / sqrt(k)` and hard
 *    iron x0. Printed are q where 1/q belongs, and k with the wrong sign.
 *  - eq. 52 needs A positive definite: a quadric that is not is no ellipsoid, and is refused.
 */
#include "closed_form.h"
#include "fast_code.h"

FAST_CODE void magnetometer_direct(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    int32_t anchor[3];
    moments_t sums;

    fit->iterations = 0;
    fit->coverage = 0.0f;
    if (points->count < FIT_ELLIPSOID_UNKNOWNS) {
        fit_nothing(FIT_TOO_FEW_POINTS, fit);
        return;
    }
    moments_anchor(points, anchor);
    moments_sum(points, anchor, &sums);
    fit_closed_form(&sums, anchor, fit);
}
