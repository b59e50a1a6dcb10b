/**
 * @file packed_points.h
 * @brief Points packed two a word as they are stored, about the centre of a calibration before: what `direct-fast` need not do then.
 */
#ifndef HILTEST_PACKED_POINTS_H
#define HILTEST_PACKED_POINTS_H

#include "stream_calibrator.h"

/** As many points as there is room for. */
#define PACKED_POINTS_MAXIMUM 512u

/** Two points and their products; in each word the lower half is the first point's, in `y` the upper. */
typedef struct {
    uint32_t x, y, z;                /**< relative to the anchor [counts] */
    uint32_t xx, yy, zz, xy, xz, yz; /**< [2^(16-2K) counts^2]; see packed_moments.h */
} packed_pair_t;

typedef struct packed_points {
    packed_pair_t pairs[PACKED_POINTS_MAXIMUM / 2u];
    int32_t anchor[3];  /**< [counts] */
    int32_t sums[3];    /**< of the coordinates about it [counts] */
    int32_t farthest;   /**< the largest of them, whatever its sign [counts] */
    uint32_t count;     /**< of points */
} packed_points_t;

/** Forget all points, and pack those that come about an anchor [counts]. */
void packed_points_start(packed_points_t *packed, const int32_t anchor[3]);

/** Store a point [counts] in a packed_points_t: a step, so that it is counted as those of streams are. */
stream_status_t packed_points_add(void *state, const int16_t point[3]);

#endif
