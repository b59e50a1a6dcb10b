/* The kernel of packed_moments.h in plain C, for a host: the same bits, without its speed. */
#include "packed_moments.h"

#if !defined(__arm__)

#include <stddef.h>

enum { X, Y, Z, XX, YY, ZZ, XY, XZ, YZ, WORDS, ONE };

/* The two factors of every sum, in the order of moments_t. */
static const uint8_t factors[][2] = {
    {X, ONE}, {Y, ONE}, {Z, ONE}, {XX, ONE}, {XY, ONE}, {XZ, ONE}, {YY, ONE}, {YZ, ONE}, {ZZ, ONE},
    {XX, X},  {XX, Y},  {XX, Z},  {YY, X},   {YZ, X},   {XZ, Z},   {YY, Y},   {YY, Z},   {YZ, Z},   {ZZ, Z},
    {XX, XX}, {XX, XY}, {XX, XZ}, {XY, XY},  {XY, XZ},  {XZ, XZ},  {YY, XY},  {YY, XZ},  {XZ, YZ},  {ZZ, XZ},
    {YY, YY}, {YY, YZ}, {YZ, YZ}, {ZZ, YZ},  {ZZ, ZZ},
};
#define SUMS (sizeof factors / sizeof factors[0])

static int32_t product(int32_t a, int32_t b, uint32_t rounding)
{
    const int32_t unit = 1 << (rounding & 0xffu);
    return ((int16_t)(a * unit) * (int16_t)(b * unit) + (int32_t)rounding) >> 16;
}

static int32_t anchored(const packed_block_t *block, uint32_t index, int axis)
{
    const int16_t anchor[3] = {(int16_t)block->anchor[0], (int16_t)block->anchor[2], (int16_t)block->anchor[1]};
    const bool is_there = index < block->count; /* what fills the last pair is the anchor */
    return is_there ? (int16_t)(block->points[index][axis] - anchor[axis]) : 0;
}

static void words_of(const packed_block_t *block, uint32_t index, int32_t words[ONE + 1])
{
    for (int axis = X; axis <= Z; axis++) {
        words[axis] = anchored(block, index, axis);
        words[XX + axis] = product(words[axis], words[axis], block->rounding);
    }
    words[XY] = product(words[X], words[Y], block->rounding);
    words[XZ] = product(words[X], words[Z], block->rounding);
    words[YZ] = product(words[Y], words[Z], block->rounding);
    words[ONE] = 1;
}

/* As SMLAD does: the sum wraps, and the overflow is returned. */
static uint32_t add(uint32_t *sum, int64_t terms)
{
    const int64_t exact = (int32_t)*sum + terms;
    *sum = (uint32_t)exact;
    return exact != (int32_t)*sum;
}

static float power_of_scale(size_t index, float scale)
{
    return index < 3 ? 1.0f : index < 19 ? scale : scale * scale;
}

uint32_t packed_moments_block(const packed_block_t *block, moments_t *sums)
{
    uint32_t totals[SUMS] = {0}, overflowed = 0;
    for (uint32_t index = 0; index < block->count; index += 2u) {
        int32_t first[ONE + 1], second[ONE + 1];
        words_of(block, index, first);
        words_of(block, index + 1u, second);
        for (size_t i = 0; i < SUMS; i++) {
            const uint8_t *const factor = factors[i];
            overflowed |= add(&totals[i], (int64_t)first[factor[0]] * first[factor[1]] + (int64_t)second[factor[0]] * second[factor[1]]);
        }
    }
    for (size_t i = 0; i < SUMS; i++) {
        (&sums->x)[i] = (float)(int32_t)totals[i] * power_of_scale(i, block->scale);
    }
    sums->one = (float)block->count;
    return overflowed;
}

#endif
