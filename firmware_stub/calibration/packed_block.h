/**
 * @file packed_block.h
 * @brief What the kernel of packed_moments.h is given: pairs of points, and the K that fits them.
 */
#ifndef HILTEST_PACKED_BLOCK_H
#define HILTEST_PACKED_BLOCK_H

#include <stdint.h>

/** Points that one call of the kernel takes: 18 bytes each of scratch. */
#define PACKED_BLOCK_POINTS 100u

/** Largest K: products are exact from here on. All coordinates times 2^K must be within -32767 and 32767. */
#define PACKED_SHIFT_MAXIMUM 8

/** Two points and their products; in each word the lower half is the first point's, in `y` the upper. */
typedef struct {
    union {
        struct {
            uint32_t x, y, z; /**< relative to the anchor [counts] */
        };
        int16_t halves[6]; /**< the same, lower halves first, as they lie in the memory of a Cortex-M4 */
    };
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
    uint32_t rounding; /**< 2^15 + K: added to products before they are cut, and its lowest byte shifts */
    uint32_t lanes;    /**< the upper half without its K lowest bits, and the lower half */
    float scale;       /**< 2^(16-2K) */
} packed_block_t;

/**
 * The largest K with room for coordinates up to `farthest` from the anchor [counts].
 *
 * They are to fill 16 bits to 3/4 at most (to 1/1.3125), although all of them would fit: the fourth powers of 100 points on a sphere
 * that fills them add up to more than 32 bits.
 */
static inline __attribute__((always_inline)) int32_t packed_block_largest_shift(int32_t farthest)
{
    const uint32_t room = (uint32_t)(farthest + (farthest >> 2) + (farthest >> 4));
    const int32_t shift = 15 - (32 - __builtin_clz(room | 1u));
    return shift < 0 ? 0 : shift > PACKED_SHIFT_MAXIMUM ? PACKED_SHIFT_MAXIMUM : shift;
}

static inline __attribute__((always_inline)) void packed_block_set_shift(int32_t shift, packed_block_t *block)
{
    const union {
        uint32_t bits;
        float value;
    } scale = {(uint32_t)(16 - 2 * shift + 127) << 23}; /* 2^(16-2K) */
    block->rounding = 0x8000u + (uint32_t)shift;
    block->lanes = ~(((1u << shift) - 1u) << 16);
    block->scale = scale.value;
}

static inline __attribute__((always_inline)) int32_t packed_block_shift(const packed_block_t *block)
{
    return (int32_t)(block->rounding & 0xffu);
}

#endif
