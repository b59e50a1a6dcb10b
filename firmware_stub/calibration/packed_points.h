/**
 * @file packed_points.h
 * @brief Points packed two a word as they are stored, about the centre of a calibration before: what `direct-fast` need not do then.
 */
#ifndef HILTEST_PACKED_POINTS_H
#define HILTEST_PACKED_POINTS_H

#include "stream_calibrator.h"

/** As many points as there is room for. */
#define PACKED_POINTS_MAXIMUM 512u

/** Points that one call of the kernel takes: 18 bytes each of scratch. */
#define PACKED_BLOCK_POINTS 100u

/** Two points and their products; in each word the lower half is the first point's, in `y` the upper. */
typedef struct {
    uint32_t x, y, z;                /**< relative to the anchor [counts] */
    uint32_t xx, yy, zz, xy, xz, yz; /**< [2^(16-2K) counts^2]; see packed_moments.h */
} packed_pair_t;

/** What the kernel is to do. */
typedef struct {
    const int16_t (*points)[3]; /**< [counts], word-aligned; NULL when `pairs` has them packed already */
    packed_pair_t *pairs;       /**< (count + 1) / 2; products are written */
    uint32_t count;             /**< of points, 2 to PACKED_BLOCK_POINTS */
    union {
        uint32_t anchor[3]; /**< two coordinates a word, as they lie in the points: y x, x z, z y */
        int32_t first[3];   /**< without points: the sums of degree 1 [counts] */
    };
    uint32_t rounding;          /**< 2^15 + K: added to products before they are cut, and its lowest byte shifts */
    uint32_t lanes;             /**< the upper half without its K lowest bits, and the lower half */
    float scale;                /**< 2^(16-2K) */
} packed_block_t;

/** Points packed, ready for the kernel if they are one block. */
typedef struct packed_points {
    packed_block_t block; /**< its count and sums of degree 1 are those of all points */
    packed_pair_t *last;  /**< the pair that has but one point, or the next */
    int32_t anchor[3];    /**< [counts] */
    int32_t farthest;     /**< the largest coordinate about it, whatever its sign [counts] */
    packed_pair_t pairs[PACKED_POINTS_MAXIMUM / 2u];
} packed_points_t;

/** Forget all points, and pack those that come about an anchor [counts]. */
void packed_points_start(packed_points_t *packed, const int32_t anchor[3]);

/** Store a point [counts] in a packed_points_t: a step, so that it is counted as those of streams are. */
stream_status_t packed_points_add(void *state, const int16_t point[3]);

#endif
