/* `direct` on moments of two points a word (packed_moments.h): fewer cycles, for an error that is printed beside them. What rounded
 * sums do not carry is left to `direct`: a plane is one only if its pivots vanish. */
#include <stddef.h>

#include "closed_form.h"
#include "fast_code.h"
#include "packed_moments.h"

/* Whether what points are packed about may be their centre: on each axis within the middle three quarters of their range, where the
 * centre of half a sphere is too. */
static inline __attribute__((always_inline)) bool may_be_centre(const packed_points_t *packed, const magnetometer_points_t *points)
{
    bool is_central = true;
#pragma GCC unroll 3
    for (int axis = 0; axis < 3; axis++) {
        const int32_t low = packed->anchor[axis] - points->minimum[axis], high = points->maximum[axis] - packed->anchor[axis];
        is_central &= low <= 7 * high && high <= 7 * low;
    }
    return is_central;
}

/* Whether an anchor has turned out to be the centre, to a quarter of the field; about one that is farther away rounding counts more,
 * and so do pivots, which judge the coverage. */
static inline __attribute__((always_inline)) bool is_centre(const int32_t anchor[3], const magnetometer_fit_t *fit)
{
    float away[3], square = 0.0f; /* of the field's strength */
#pragma GCC unroll 3
    for (int axis = 0; axis < 3; axis++) {
        away[axis] = (float)anchor[axis] - fit->hard_iron[axis];
    }
#pragma GCC unroll 3
    for (int row = 0; row < 3; row++) {
        const float *of = &fit->soft_iron[3 * row];
        const float component = of[0] * away[0] + of[1] * away[1] + of[2] * away[2];
        square += component * component;
    }
    return 16.0f * square <= 1.0f;
}

/* By the points that were packed as they were stored; false where these give no ellipsoid about what they are packed about. Apart, so
 * that its registers cost a fit without them nothing. */
FAST_CODE __attribute__((noinline, noclone)) static bool fit_packed(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    const packed_points_t *const packed = points->packed;
    moments_t sums;

    if (!may_be_centre(packed, points)) {
        return false;
    }
    if (packed_points_sum(packed, &sums) != 0u && packed_points_sum_again(packed, &sums) != 0u) {
        moments_sum(points, packed->anchor, &sums);
    }
    fit_closed_form(&sums, packed->anchor, fit);
    return fit->status == FIT_ELLIPSOID && is_centre(packed->anchor, fit);
}

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
    if (points->packed != NULL && fit_packed(points, fit)) {
        return;
    }
    moments_anchor(points, anchor);
    packed_moments_sum(points, anchor, &sums);
    fit_closed_form(&sums, anchor, fit);
    if (fit->status != FIT_ELLIPSOID) {
        magnetometer_direct(points, fit);
    }
}
