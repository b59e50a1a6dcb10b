#include "point_range.h"

#include "fast_code.h"

FAST_CODE void point_range_start(point_range_t *range, const int16_t point[3])
{
#pragma GCC unroll 3
    for (int axis = 0; axis < 3; axis++) {
        range->minimum[axis] = range->maximum[axis] = point[axis];
    }
}

/* A new extreme is rare, so nothing is stored but that. */
FAST_CODE stream_status_t point_range_add(void *state, const int16_t point[3])
{
    point_range_t *const range = state;
#pragma GCC unroll 3
    for (int axis = 0; axis < 3; axis++) {
        const int16_t value = point[axis];
        if (value < range->minimum[axis]) {
            range->minimum[axis] = value;
        }
        if (value > range->maximum[axis]) {
            range->maximum[axis] = value;
        }
    }
    return STREAM_OK;
}
