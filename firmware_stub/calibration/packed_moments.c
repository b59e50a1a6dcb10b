#include "packed_moments.h"

#include <stddef.h>

#include "fast_code.h"

#define INLINE static inline __attribute__((always_inline))

INLINE uint32_t word(int32_t upper, int32_t lower)
{
    return (uint32_t)upper << 16 | (uint16_t)lower;
}

/* 2^exponent, for exponents of a float. */
INLINE float power_of_two(int32_t exponent)
{
    const union {
        uint32_t bits;
        float value;
    } same = {(uint32_t)(exponent + 127) << 23};
    return same.value;
}

INLINE void set_anchor(const int32_t anchor[3], packed_block_t *block)
{
    block->anchor[0] = word(anchor[1], anchor[0]);
    block->anchor[1] = word(anchor[0], anchor[2]);
    block->anchor[2] = word(anchor[2], anchor[1]);
}

INLINE void set_shift(int32_t shift, packed_block_t *block)
{
    block->rounding = 0x8000u + (uint32_t)shift;
    block->lanes = ~(((1u << shift) - 1u) << 16);
    block->scale = power_of_two(16 - 2 * shift);
}

/* The farthest that a point's coordinate is from the anchor [counts]. */
INLINE int32_t farthest(const magnetometer_points_t *points, const int32_t anchor[3])
{
    int32_t most = 0;
#pragma GCC unroll 3
    for (int axis = 0; axis < 3; axis++) {
        const int32_t above = points->maximum[axis] - anchor[axis], below = anchor[axis] - points->minimum[axis];
        most = above > most ? above : most;
        most = below > most ? below : most;
    }
    return most;
}

/* Coordinates are to fill 16 bits to 3/4 at most (to 1/1.3125), although all of them would fit: the fourth powers of 100 points on
 * a sphere that fills them add up to more than 32 bits. */
INLINE int32_t largest_shift(int32_t most)
{
    const uint32_t room = (uint32_t)(most + (most >> 2) + (most >> 4));
    const int32_t shift = 15 - (32 - __builtin_clz(room | 1u));
    return shift < 0 ? 0 : shift > PACKED_SHIFT_MAXIMUM ? PACKED_SHIFT_MAXIMUM : shift;
}

/* One block, with K or, when that overflows, with K - 1, which makes fourth powers a sixteenth; then it stays at that. */
static FAST_CODE bool sum_block(packed_block_t *block, int32_t *shift, moments_t *sums)
{
    if (packed_moments_block(block, sums) == 0u) {
        return true;
    }
    if (*shift == 0) {
        return false;
    }
    set_shift(--*shift, block);
    return packed_moments_block(block, sums) == 0u;
}

/* What no K holds is summed one point at a time. */
static FAST_CODE void sum_raw_block(packed_block_t *block, const int32_t anchor[3], int32_t *shift, moments_t *sums)
{
    if (!sum_block(block, shift, sums)) {
        const magnetometer_points_t points = {.points = block->points, .count = (uint16_t)block->count};
        moments_sum(&points, anchor, sums);
    }
}

/* A block is never a single point. */
INLINE uint32_t next_block(uint32_t left)
{
    return left == PACKED_BLOCK_POINTS + 1u ? PACKED_BLOCK_POINTS - 2u : left < PACKED_BLOCK_POINTS ? left : PACKED_BLOCK_POINTS;
}

FAST_CODE void packed_moments_sum(const magnetometer_points_t *points, const int32_t anchor[3], moments_t *sums)
{
    packed_pair_t pairs[PACKED_BLOCK_POINTS / 2u];
    packed_block_t block; /* no initialiser: it would clear all first */
    const int32_t most = farthest(points, anchor);
    int32_t shift = largest_shift(most);
    uint32_t left = points->count;
    const bool is_aligned = (uintptr_t)points->points % sizeof(uint32_t) == 0u; /* the kernel loads words */
    if (most > INT16_MAX || left < 2u || !is_aligned) {
        moments_sum(points, anchor, sums);
        return;
    }
    block.points = points->points;
    block.pairs = pairs;
    block.count = next_block(left);
    set_anchor(anchor, &block);
    set_shift(shift, &block);
    sum_raw_block(&block, anchor, &shift, sums);
    while ((left -= block.count) > 0u) {
        moments_t more;
        block.points += block.count;
        block.count = next_block(left);
        sum_raw_block(&block, anchor, &shift, &more);
        more.one = 0.0f;
        moments_merge(sums, &more);
    }
    sums->one = (float)points->count; /* the kernel leaves the count alone */
}

/* More than one block, or one that overflows; apart, so that the one that does not need not make room for it. */
static FAST_CODE __attribute__((noinline)) bool sum_more_blocks(const packed_points_t *packed, int32_t *shift, moments_t *sums)
{
    packed_block_t block = packed->block;
    uint32_t left = block.count;
    block.count = next_block(left);
    if (!sum_block(&block, shift, sums)) {
        return false;
    }
    block.first[0] = block.first[1] = block.first[2] = 0; /* those of all points are in the first */
    while ((left -= block.count) > 0u) {
        moments_t more;
        block.pairs += block.count / 2u;
        block.count = next_block(left);
        if (!sum_block(&block, shift, &more)) {
            return false;
        }
        more.one = 0.0f; /* that of all points is in `sums` */
        moments_merge(sums, &more);
    }
    return true;
}

FAST_CODE bool packed_points_sum(packed_points_t *packed, moments_t *sums)
{
    int32_t shift = largest_shift(packed->farthest);
    if (packed->farthest > INT16_MAX) {
        return false;
    }
    set_shift(shift, &packed->block);
    sums->one = (float)packed->block.count;
    if (packed->block.count <= PACKED_BLOCK_POINTS && packed_moments_block(&packed->block, sums) == 0u) {
        return true;
    }
    return sum_more_blocks(packed, &shift, sums);
}
