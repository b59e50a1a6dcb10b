/* The thesis' algebraic fit, its equations corrected: least squares of the quadric of unit trace, then the symmetric matrix
 * and the offset that take that ellipsoid to the unit sphere. No iteration over the points, no eigenvalues. */
#include "fast_code.h"
#include "fit_result.h"
#include "normal_equations.h"
#include "square_root.h"

/* Largest M_ii/d_i on the mid-range anchor: at most 1.7 for a full sphere, 6 to 30 for half of one, 31 to 158 for 30 % of one
 * (simulated at 0.4 uT). Beyond this the ellipsoid follows the noise, not the field. */
#define COVERAGE_LIMIT 30.0f

FAST_CODE void magnetometer_direct(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    int32_t anchor[3];
    moments_t sums;
    quadric_t quadric;
    ellipsoid_t ellipsoid;

    fit->iterations = 0;
    fit->coverage = 0.0f;
    if (points->count < FIT_ELLIPSOID_UNKNOWNS) {
        fit_nothing(FIT_TOO_FEW_POINTS, fit);
        return;
    }
    moments_anchor(points, anchor);
    moments_sum(points, anchor, &sums);
    fit->coverage = quadric_fit(&sums, &quadric);
    if (fit->coverage > COVERAGE_LIMIT) {
        fit_sphere(&sums, anchor, FIT_POOR_COVERAGE, fit);
        return;
    }
    if (!quadric_ellipsoid(&quadric, &ellipsoid)) {
        fit_sphere(&sums, anchor, FIT_NOT_AN_ELLIPSOID, fit);
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
