/* The thesis' algebraic fit, its equations corrected: least squares of the quadric of unit trace, then the symmetric matrix
 * and the offset that take that ellipsoid to the unit sphere. No iteration over the points, no eigenvalues. */
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
