#include "packed_moments.h"

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

FAST_CODE void packed_block_set(const int32_t anchor[3], int32_t shift, packed_block_t *block)
{
    block->anchor[0] = word(anchor[1], anchor[0]);
    block->anchor[1] = word(anchor[0], anchor[2]);
    block->anchor[2] = word(anchor[2], anchor[1]);
    block->rounding = 0x8000u + (uint32_t)shift;
    block->lanes = ~(((1u << shift) - 1u) << 16);
    block->scale = power_of_two(16 - 2 * shift);
}

/* The farthest that a point's coordinate is from the anchor [counts]. */
INLINE int32_t farthest(const magnetometer_points_t *points, const int32_t anchor[3])
{
    int32_t most = 0;
    for (int axis = 0; axis < 3; axis++) {
        const int32_t above = points->maximum[axis] - anchor[axis], below = anchor[axis] - points->minimum[axis];
        most = above > most ? above : most;
        most = below > most ? below : most;
    }
    return most;
}

/* Coordinates are to use the 16 bits as far as 3/4: a sphere that fills them overflows the sums of 100 points. */
INLINE int32_t largest_shift(int32_t most)
{
    int32_t shift = PACKED_SHIFT_MAXIMUM;
    while (shift > 0 && most << shift > 24576) {
        shift--;
    }
    return shift;
}

FAST_CODE void packed_moments_sum(const magnetometer_points_t *points, const int32_t anchor[3], moments_t *sums)
{
    packed_pair_t pairs[PACKED_BLOCK_POINTS / 2u];
    packed_block_t block = {.points = points->points, .count = points->count, .pairs = pairs};
    const int32_t most = farthest(points, anchor);
    packed_block_set(anchor, largest_shift(most), &block);
    sums->one = (float)points->count;
    (void)packed_moments_block(&block, &sums->x);
}

#if !defined(__arm__)
/* todo */
uint32_t packed_moments_block(const packed_block_t *block, float *sums)
{
    (void)block;
    sums[0] = 0;
    return 0;
}
#endif
