/* `direct` on moments that two points a word give (packed_moments.h): fewer cycles, and an error that is printed beside them. */
#include "closed_form.h"
#include "fast_code.h"
#include "packed_moments.h"

FAST_CODE void magnetometer_direct_fast(const magnetometer_points_t *points, magnetometer_fit_t *fit)
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
    packed_moments_sum(points, anchor, &sums);
    fit_closed_form(&sums, anchor, fit);
}
