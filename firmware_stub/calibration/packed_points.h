/**
 * @file packed_points.h
 * @brief Points packed two a word as they are stored, about the centre of a calibration before: what `direct-fast` need not do then.
 */
#ifndef HILTEST_PACKED_POINTS_H
#define HILTEST_PACKED_POINTS_H

#include "packed_block.h"
#include "stream_calibrator.h"

/** As many points as there is room for. */
#define PACKED_POINTS_MAXIMUM 512u

/** Points packed, ready for the kernel if they are one block. */
typedef struct packed_points {
    packed_block_t block; /**< its count and sums of degree 1 are those of all points, its K has room for all */
    packed_pair_t *last;  /**< the pair that has but one point, or the next */
    int32_t anchor[3];    /**< [counts] */
    int32_t farthest;     /**< the largest coordinate about it, whatever its sign [counts] */
    packed_pair_t pairs[PACKED_POINTS_MAXIMUM / 2u];
} packed_points_t;

/** Forget all points, and pack those that come about an anchor [counts]. */
void packed_points_start(packed_points_t *packed, const int32_t anchor[3]);

/**
 * Store a point [counts] in a packed_points_t: a step, so that it is counted as those of streams are.
 *
 * K is chosen here, when a point is the farthest so far: seldom, where it would be once for every fit.
 */
stream_status_t packed_points_add(void *state, const int16_t point[3]);

#endif
