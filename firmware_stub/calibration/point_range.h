/**
 * @file point_range.h
 * @brief The range of points, kept as they are stored: what a calibrator that anchors at its middle would need a pass for.
 */
#ifndef HILTEST_POINT_RANGE_H
#define HILTEST_POINT_RANGE_H

#include "stream_calibrator.h"

/** Smallest and largest x, y, z [counts]. */
typedef struct {
    int16_t minimum[3];
    int16_t maximum[3];
} point_range_t;

/** The range of one point [counts]. */
void point_range_start(point_range_t *range, const int16_t point[3]);

/** Make room for a point [counts] in a point_range_t: a step, so that it is counted as those of streams are. */
stream_status_t point_range_add(void *state, const int16_t point[3]);

#endif
