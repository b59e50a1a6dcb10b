/**
 * @file exact_moments.h
 * @brief The 34 sums of monomials as integers: what is added can be taken away again, and nothing is left of it.
 */
#ifndef HILTEST_EXACT_MOMENTS_H
#define HILTEST_EXACT_MOMENTS_H

#include "moments.h"

/** Largest coordinate [counts] and largest number of points that the 32-bit sums have room for. */
#define EXACT_MOMENTS_LARGEST 2047
#define EXACT_MOMENTS_POINTS 512

_Static_assert((uint64_t)EXACT_MOMENTS_POINTS *EXACT_MOMENTS_LARGEST *EXACT_MOMENTS_LARGEST < (uint64_t)1 << 31,
               "sums of degree 2 must fit 32 bits");
_Static_assert(EXACT_MOMENTS_LARGEST < 1 << 11 && EXACT_MOMENTS_POINTS <= 1 << 9,
               "about any of the points coordinates are below 2^12, so sums of degree 4 stay below 2^57");

/**
 * Sums of the monomials that the members are named after [counts^degree], two's complement.
 *
 * Unsigned, so that taking away what was never added leaves wrong sums and not undefined ones. The product of two products of
 * two coordinates fits 64 bits, those of two fit 32: one SMLAL a sum.
 */
typedef struct {
    uint32_t x, y, z;
    uint32_t xx, xy, xz, yy, yz, zz;
    uint64_t xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz;
    uint64_t xxxx, xxxy, xxxz, xxyy, xxyz, xxzz, xyyy, xyyz, xyzz, xzzz, yyyy, yyyz, yyzz, yzzz, zzzz;
} exact_moments_t;

/** Add a point; coordinates at most EXACT_MOMENTS_LARGEST either way. */
void exact_moments_add(exact_moments_t *sums, int32_t x, int32_t y, int32_t z);

/** Take a point away again. */
void exact_moments_remove(exact_moments_t *sums, int32_t x, int32_t y, int32_t z);

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
