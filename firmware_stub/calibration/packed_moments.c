#include "packed_moments.h"

#include <stddef.h>

#include "fast_code.h"

_Static_assert(sizeof(packed_pair_t) == 36u, "the kernel steps over pairs of so many bytes");
#if defined(__arm__)
_Static_assert(offsetof(packed_block_t, anchor) == 12u && offsetof(packed_block_t, scale) == 32u, "the kernel reads its task there");
#endif

#define INLINE static inline __attribute__((always_inline))

/* Largest K: products are exact from here on. */
#define SHIFT_MAXIMUM 8

/*
 * The largest K with room for coordinates up to `farthest` from the anchor [counts].
 *
 * They are to fill 16 bits to 3/4 at most (to 1/1.3125), although all of them would fit: the fourth powers of 100 points on a sphere
 * that fills them add up to more than 32 bits.
 */
INLINE int32_t largest_shift(int32_t farthest)
{
    const uint32_t room = (uint32_t)(farthest + (farthest >> 2) + (farthest >> 4));
    const int32_t shift = 15 - (32 - __builtin_clz(room | 1u));
    return shift < 0 ? 0 : shift > SHIFT_MAXIMUM ? SHIFT_MAXIMUM : shift;
}

INLINE void set_shift(int32_t shift, packed_block_t *block)
{
    const union {
        uint32_t bits;
        float value;
    } scale = {(uint32_t)(16 - 2 * shift + 127) << 23}; /* 2^(16-2K) */
    block->rounding = 0x8000u + (uint32_t)shift;
    block->lanes = ~(((1u << shift) - 1u) << 16);
    block->scale = scale.value;
}

INLINE int32_t shift_of(const packed_block_t *block)
{
    return (int32_t)(block->rounding & 0xffu);
}

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

/* One block again, with a K smaller by one, which makes fourth powers a sixteenth; then it stays at that. Blocks that this K does not hold
 * either are summed one point at a time. */
static FAST_CODE __attribute__((noinline)) void sum_again(packed_block_t *block, const int32_t anchor[3], moments_t *sums)
{
    const int32_t shift = shift_of(block);
    if (shift > 0) {
        set_shift(shift - 1, block);
        if (packed_moments_block(block, sums) == 0u) {
            return;
        }
    }
    const magnetometer_points_t points = {.points = block->points, .count = (uint16_t)block->count};
    moments_sum(&points, anchor, sums);
}

INLINE void sum_block(packed_block_t *block, const int32_t anchor[3], moments_t *sums)
{
    if (packed_moments_block(block, sums) != 0u) {
        sum_again(block, anchor, sums);
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
    set_shift(largest_shift(most), &block);
    sum_block(&block, anchor, sums);
    while ((left -= block.count) > 0u) {
        moments_t more;
        block.points += block.count;
        block.count = next_block(left);
        sum_block(&block, anchor, &more);
        moments_merge(sums, &more);
    }
}
