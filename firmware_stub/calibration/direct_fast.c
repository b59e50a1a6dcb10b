/* `direct` on moments of two points a word (packed_moments.h): fewer cycles, for an error that is printed beside them. What rounded
 * sums do not carry is left to `direct`: a plane is one only if its pivots vanish. */
#include <stddef.h>

#include "closed_form.h"
#include "fast_code.h"
#include "packed_moments.h"

/* Whether points are packed about something like their centre: on each axis within the middle three quarters of their range, which
 * a point of the surface is not on all three. About any other anchor rounding counts many times as much. */
static inline __attribute__((always_inline)) bool are_packed(const magnetometer_points_t *points)
{
    const packed_points_t *const packed = points->packed;
    if (packed == NULL) {
        return false;
    }
    bool is_central = true;
#pragma GCC unroll 3
    for (int axis = 0; axis < 3; axis++) {
        const int32_t low = packed->anchor[axis] - points->minimum[axis], high = points->maximum[axis] - packed->anchor[axis];
        is_central &= low <= 7 * high && high <= 7 * low;
    }
    return is_central;
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
    if (!are_packed(points)) {
        moments_anchor(points, anchor);
        packed_moments_sum(points, anchor, &sums);
    } else {
        anchor[0] = points->packed->anchor[0];
        anchor[1] = points->packed->anchor[1];
        anchor[2] = points->packed->anchor[2];
        if (packed_points_sum(points->packed, &sums) != 0u && packed_points_sum_again(points->packed, &sums) != 0u) {
            moments_sum(points, anchor, &sums);
        }
    }
    fit_closed_form(&sums, anchor, fit);
    if (fit->status != FIT_ELLIPSOID) {
        magnetometer_direct(points, fit);
    }
}
