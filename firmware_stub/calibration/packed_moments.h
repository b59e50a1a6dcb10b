/**
 * @file packed_moments.h
 * @brief The 34 moments with the two 16-bit multipliers that a Cortex-M4 has: two points a word, one instruction for both.
 *
 * Scheme. Coordinates d relative to the anchor are int16, those of two points in one word. A product of two of them is rounded to
 * 16 bits, `A = floor(d e 2^(2K) / 2^16 + 1/2)`, and all sums are formed from coordinates and these six products: of degree 2 their
 * sums, of degree 3 product times coordinate, of degree 4 product times product. One multiply-accumulate (SMLAD) adds both points.
 * Every sum is an int32 that wraps; one that does so in a multiply-accumulate sets the core's sticky Q flag, which is the answer.
 *
 * The same rounded products in the sums of all degrees is what keeps the fit: with exact sums of degree 2 beside rounded ones of
 * degree 4, rounding no longer cancels in the residuals. The anchor must be near the centre for the same reason.
 *
 * Preconditions of the kernel: K as below, which the range must be known for (no flag shows when a coordinate does not fit); at most
 * PACKED_BLOCK_POINTS points, from word-aligned memory. packed_moments_sum sees to all of them.
 *
 * Costs, in the cycle model at zero wait states: 50.8 cycles a point and 320 a block. The accuracy that remains is in
 * DESIGN.md beside the cycles of each part. The scheme is our own; the sums are those of moments.h.
 */
#ifndef HILTEST_PACKED_MOMENTS_H
#define HILTEST_PACKED_MOMENTS_H

#include <stdbool.h>

#include "moments.h"

/** Points that one call of the kernel takes: 18 bytes each of scratch. */
#define PACKED_BLOCK_POINTS 100u

/** Two points and their products; in each word the lower half is the first point's, in `y` the upper. */
typedef struct {
    uint32_t x, y, z;                /**< relative to the anchor [counts] */
    uint32_t xx, yy, zz, xy, xz, yz; /**< [2^(16-2K) counts^2] */
} packed_pair_t;

/** The task of the kernel. All coordinates times 2^K must be within -32767 and 32767. */
typedef struct {
    const int16_t (*points)[3]; /**< [counts], word-aligned */
    packed_pair_t *pairs;       /**< scratch, (count + 1) / 2 of them */
    uint32_t count;             /**< of points, 2 to PACKED_BLOCK_POINTS */
    uint32_t anchor[3];         /**< two coordinates a word, as they lie in the points: y x, x z, z y */
    uint32_t rounding;          /**< 2^15 + K: added to products before they are cut, and its lowest byte shifts */
    uint32_t lanes;             /**< the upper half without its K lowest bits, and the lower half */
    float scale;                /**< 2^(16-2K) */
} packed_block_t;

/**
 * Sum the moments of a block.
 *
 * @param block what to sum
 * @param[out] sums the 34 moments and the count
 * @return 1 when a sum has wrapped, so that nothing of `sums` is valid, else 0
 */
uint32_t packed_moments_block(const packed_block_t *block, moments_t *sums);

/**
 * Sum the moments of any number of points.
 *
 * Blocks that overflow are redone with K - 1, and by moments_sum if that is not enough, so the result is always valid.
 *
 * @param points at least one, and their range; word-aligned, or moments_sum sums them all
 * @param anchor [counts]; any point, but the fit is as good as it is near the centre
 * @param[out] sums the 34 moments and the count
 */
void packed_moments_sum(const magnetometer_points_t *points, const int32_t anchor[3], moments_t *sums);

#endif
