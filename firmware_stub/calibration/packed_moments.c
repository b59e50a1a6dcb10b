#include "packed_moments.h"

#include <stddef.h>

#include "fast_code.h"

#define INLINE static inline __attribute__((always_inline))

INLINE uint32_t word(int32_t upper, int32_t lower)
{
    return (uint32_t)upper << 16 | (uint16_t)lower;
}

INLINE void set_anchor(const int32_t anchor[3], packed_block_t *block)
{
    block->anchor[0] = word(anchor[1], anchor[0]);
    block->anchor[1] = word(anchor[0], anchor[2]);
    block->anchor[2] = word(anchor[2], anchor[1]);
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

/* One block again, with a K smaller by one, which makes fourth powers a sixteenth; then it stays at that. */
static FAST_CODE bool sum_smaller(packed_block_t *block, moments_t *sums)
{
    const int32_t shift = packed_block_shift(block);
    if (shift == 0) {
        return false;
    }
    packed_block_set_shift(shift - 1, block);
    return packed_moments_block(block, sums) == 0u;
}

static FAST_CODE bool sum_block(packed_block_t *block, moments_t *sums)
{
    return packed_moments_block(block, sums) == 0u || sum_smaller(block, sums);
}

/* What no K holds is summed one point at a time. */
static FAST_CODE void sum_raw_block(packed_block_t *block, const int32_t anchor[3], moments_t *sums)
{
    if (!sum_block(block, sums)) {
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
    packed_block_set_shift(packed_block_largest_shift(most), &block);
    sum_raw_block(&block, anchor, sums);
    while ((left -= block.count) > 0u) {
        moments_t more;
        block.points += block.count;
        block.count = next_block(left);
        sum_raw_block(&block, anchor, &more);
        moments_merge(sums, &more);
    }
}

static FAST_CODE __attribute__((noinline)) uint32_t sum_packed_blocks(const packed_points_t *packed, moments_t *sums)
{
    packed_block_t block = packed->block;
    uint32_t left = block.count;
    block.count = next_block(left);
    if (!sum_block(&block, sums)) {
        return 1u;
    }
    block.first[0] = block.first[1] = block.first[2] = 0; /* those of all points are in the first */
    while ((left -= block.count) > 0u) {
        moments_t more;
        block.pairs += block.count / 2u;
        block.count = next_block(left);
        if (!sum_block(&block, &more)) {
            return 1u;
        }
        moments_merge(sums, &more);
    }
    return 0u;
}

/* Nothing is kept for afterwards, so that one block, the usual case, is a jump into the kernel. */
FAST_CODE uint32_t packed_points_sum(const packed_points_t *packed, moments_t *sums)
{
    if (packed->block.count > PACKED_BLOCK_POINTS) {
        return sum_packed_blocks(packed, sums);
    }
    return packed_moments_block(&packed->block, sums);
}

FAST_CODE uint32_t packed_points_sum_again(const packed_points_t *packed, moments_t *sums)
{
    packed_block_t block = packed->block;
    return block.count > PACKED_BLOCK_POINTS || !sum_smaller(&block, sums);
}
