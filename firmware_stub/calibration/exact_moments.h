/**
 * @file exact_moments.h
 * @brief The 34 sums of monomials as integers: what is added can be taken away again, and nothing is left of it.
 */
#ifndef HILTEST_EXACT_MOMENTS_H
#define HILTEST_EXACT_MOMENTS_H

#include <stdint.h>

#include "moments.h"

/** Largest coordinate [counts] and largest number of points that the 32-bit sums have room for. */
#define EXACT_MOMENTS_LARGEST 2047
#define EXACT_MOMENTS_POINTS 512

_Static_assert((uint64_t)EXACT_MOMENTS_POINTS *EXACT_MOMENTS_LARGEST *EXACT_MOMENTS_LARGEST < (uint64_t)1 << 31,
               "sums of degree 2 must fit 32 bits");
_Static_assert(EXACT_MOMENTS_LARGEST < 1 << 11 && EXACT_MOMENTS_POINTS <= 1 << 9,
               "about any of the points coordinates are below 2^12, so sums of degree 4 stay below 2^57");

/** A sum of 64 bits in its two words. */
typedef struct {
    uint32_t low, high;
} wide_sum_t;

/**
 * Sums of all monomials by degree, within a degree in the order of moments_t [counts^degree], two's complement.
 *
 * Unsigned, so that taking away what was never added leaves wrong sums and not undefined ones. The product of two coordinates fits
 * 32 bits, that of two such products 64: one SMLAL a sum.
 */
typedef struct {
    uint32_t first[3];
    uint32_t second[6];
    wide_sum_t third[10];
    wide_sum_t fourth[15];
} exact_moments_t;

/* Wide sums are taken two at a time (three would spill registers, but for the last), word by word: behind one load the next takes
 * one cycle, and so does a store, where those of two words take three. Volatile keeps the compiler from joining them again. */

static inline __attribute__((always_inline)) void exact_moments_sum_3(volatile uint32_t *sums, int32_t a, int32_t b, int32_t c)
{
    const uint32_t first = sums[0], second = sums[1], third = sums[2];
    sums[0] = first + (uint32_t)a;
    sums[1] = second + (uint32_t)b;
    sums[2] = third + (uint32_t)c;
}

static inline __attribute__((always_inline)) uint64_t exact_moments_mac(uint32_t low, uint32_t high, int32_t a, int32_t b)
{
    return ((uint64_t)high << 32 | low) + (uint64_t)((int64_t)a * b);
}

/* Add a0 * b0 and a1 * b1. */
static inline __attribute__((always_inline)) void
exact_moments_mac_2(volatile wide_sum_t *sums, int32_t a0, int32_t b0, int32_t a1, int32_t b1)
{
    const uint32_t low0 = sums[0].low, high0 = sums[0].high, low1 = sums[1].low, high1 = sums[1].high;
    const uint64_t sum0 = exact_moments_mac(low0, high0, a0, b0), sum1 = exact_moments_mac(low1, high1, a1, b1);
    sums[0].low = (uint32_t)sum0;
    sums[0].high = (uint32_t)(sum0 >> 32);
    sums[1].low = (uint32_t)sum1;
    sums[1].high = (uint32_t)(sum1 >> 32);
}

/* Add a0 * b0, a1 * b1, a2 * b2. */
static inline __attribute__((always_inline)) void
exact_moments_mac_3(volatile wide_sum_t *sums, int32_t a0, int32_t b0, int32_t a1, int32_t b1, int32_t a2, int32_t b2)
{
    const uint32_t low0 = sums[0].low, high0 = sums[0].high, low1 = sums[1].low, high1 = sums[1].high;
    const uint32_t low2 = sums[2].low, high2 = sums[2].high;
    const uint64_t sum0 = exact_moments_mac(low0, high0, a0, b0), sum1 = exact_moments_mac(low1, high1, a1, b1);
    const uint64_t sum2 = exact_moments_mac(low2, high2, a2, b2);
    sums[0].low = (uint32_t)sum0;
    sums[0].high = (uint32_t)(sum0 >> 32);
    sums[1].low = (uint32_t)sum1;
    sums[1].high = (uint32_t)(sum1 >> 32);
    sums[2].low = (uint32_t)sum2;
    sums[2].high = (uint32_t)(sum2 >> 32);
}

/**
 * Add a point (sign 1) or take it away again (sign -1).
 *
 * Inline, so that a step of a stream is one function. The sign is a constant there and goes into one factor of each product.
 *
 * @param[in,out] sums see exact_moments_t
 * @param x, y, z coordinates, at most EXACT_MOMENTS_LARGEST either way
 */
static inline __attribute__((always_inline)) void
exact_moments_accumulate(exact_moments_t *sums, int32_t x, int32_t y, int32_t z, int32_t sign)
{
    const int32_t sx = sign * x, sy = sign * y, sz = sign * z;
    const int32_t xx = x * x, yy = y * y, zz = z * z, xy = x * y;
    exact_moments_sum_3(sums->first, sx, sy, sz);
    exact_moments_mac_2(&sums->third[0], xx, sx, xx, sy);
    exact_moments_mac_2(&sums->third[2], xx, sz, yy, sx);
    exact_moments_mac_2(&sums->third[4], xy, sz, zz, sx);
    exact_moments_mac_2(&sums->third[6], yy, sy, yy, sz);
    exact_moments_mac_2(&sums->third[8], zz, sy, zz, sz);
    const int32_t xz = x * z, yz = y * z;
    const int32_t sxx = sign * xx, sxy = sign * xy, sxz = sign * xz, syy = sign * yy, syz = sign * yz, szz = sign * zz;
    exact_moments_sum_3(&sums->second[0], sxx, sxy, sxz);
    exact_moments_sum_3(&sums->second[3], syy, syz, szz);
    exact_moments_mac_2(&sums->fourth[0], sxx, xx, sxx, xy);
    exact_moments_mac_2(&sums->fourth[2], sxx, xz, sxx, yy);
    exact_moments_mac_2(&sums->fourth[4], sxx, yz, sxx, zz);
    exact_moments_mac_2(&sums->fourth[6], sxy, yy, sxz, yy);
    exact_moments_mac_2(&sums->fourth[8], sxy, zz, sxz, zz);
    exact_moments_mac_2(&sums->fourth[10], syy, yy, syy, yz);
    exact_moments_mac_3(&sums->fourth[12], syy, zz, syz, zz, szz, zz);
}

/**
 * Move the origin to the points' mean, exactly, then round to float32.
 *
 * @param sums of `count` points
 * @param count at least 1
 * @param[out] mean the new origin in the old coordinates, fractions cut off [counts]
 * @param[out] moments about the mean, each within one unit in the last place of float32
 */
void exact_moments_about_mean(const exact_moments_t *sums, uint16_t count, int32_t mean[3], moments_t *moments);

#endif
