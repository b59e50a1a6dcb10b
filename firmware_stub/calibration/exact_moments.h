/**
 * @file exact_moments.h
 * @brief The 34 sums of monomials as integers: what is added can be taken away again, and nothing is left of it.
 */
#ifndef HILTEST_EXACT_MOMENTS_H
#define HILTEST_EXACT_MOMENTS_H

#include <stdint.h>

#include "moments.h"

/** Largest coordinate [counts] and largest number of points that the 32-bit sums have room for. */
#define EXACT_MOMENTS_BITS 11
#define EXACT_MOMENTS_LARGEST ((1 << EXACT_MOMENTS_BITS) - 1)
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

/* Each sum is loaded before the one at hand is stored. A store right behind a load takes no cycle of its own, and a load that no
 * store precedes does not wait: so a word costs one cycle to load and one to store, as in the longest of groups, and few registers.
 * Assembly, because a compiler that may choose takes other orders, and moves sums about for SMLAL, which adds in place. */

/** A sum of one word or two in registers, and where it belongs. */
typedef struct {
    uint32_t *home;
    uint32_t low, high;
    int words;
} open_sum_t;

/* Store the sum at hand and take up one of one word. */
static inline __attribute__((always_inline)) void exact_moments_next(open_sum_t *sum, uint32_t *next)
{
    uint32_t loaded;
#if defined(__arm__)
    if (sum->words == 2) {
        __asm__ volatile("ldr %0, %3\n\tstr %4, %1\n\tstr %5, %2"
                         : "=&r"(loaded), "=m"(sum->home[0]), "=m"(sum->home[1])
                         : "m"(*next), "r"(sum->low), "r"(sum->high));
    } else {
        __asm__ volatile("ldr %0, %2\n\tstr %3, %1" : "=&r"(loaded), "=m"(sum->home[0]) : "m"(*next), "r"(sum->low));
    }
#else
    loaded = *next;
    sum->home[0] = sum->low;
    if (sum->words == 2) {
        sum->home[1] = sum->high;
    }
#endif
    *sum = (open_sum_t){.home = next, .low = loaded, .words = 1};
}

/* Store the sum at hand, take up one of one word and add to it. */
static inline __attribute__((always_inline)) void exact_moments_add(open_sum_t *sum, uint32_t *next, int32_t term)
{
    exact_moments_next(sum, next);
    sum->low += (uint32_t)term;
}

/* Store the sum at hand, take up one of two words and add a * b. */
static inline __attribute__((always_inline)) void exact_moments_mac(open_sum_t *sum, wide_sum_t *next, int32_t a, int32_t b)
{
#if defined(__arm__)
    uint32_t low, high;
    if (sum->words == 2) {
        __asm__ volatile("ldr %0, %4\n\tldr %1, %5\n\tstr %6, %2\n\tstr %7, %3\n\tsmlal %0, %1, %8, %9"
                         : "=&r"(low), "=&r"(high), "=m"(sum->home[0]), "=m"(sum->home[1])
                         : "m"(next->low), "m"(next->high), "r"(sum->low), "r"(sum->high), "r"(a), "r"(b));
    } else {
        __asm__ volatile("ldr %0, %3\n\tldr %1, %4\n\tstr %5, %2\n\tsmlal %0, %1, %6, %7"
                         : "=&r"(low), "=&r"(high), "=m"(sum->home[0])
                         : "m"(next->low), "m"(next->high), "r"(sum->low), "r"(a), "r"(b));
    }
    *sum = (open_sum_t){.home = &next->low, .low = low, .high = high, .words = 2};
#else
    exact_moments_next(sum, &next->low);
    const uint64_t wide = ((uint64_t)next->high << 32 | sum->low) + (uint64_t)((int64_t)a * b);
    *sum = (open_sum_t){.home = &next->low, .low = (uint32_t)wide, .high = (uint32_t)(wide >> 32), .words = 2};
#endif
}

/**
 * Add a point (sign 1) or take it away again (sign -1).
 *
 * Inline, so that a step of a stream is one function, and the sign a constant. Sums of odd degree change by those of the point
 * times the sign; in the others the sign goes into one factor.
 *
 * @param[in,out] sums see exact_moments_t
 * @param x, y, z coordinates times the sign, at most EXACT_MOMENTS_LARGEST either way
 * @param xx, yy, zz their squares, which the caller has
 */
static inline __attribute__((always_inline)) void exact_moments_accumulate(exact_moments_t *sums, int32_t x, int32_t y, int32_t z,
                                                                           int32_t xx, int32_t yy, int32_t zz, int32_t sign)
{
    const int32_t xy = x * y;
    open_sum_t sum = {.home = &sums->first[0], .low = sums->first[0] + (uint32_t)x, .words = 1};
    exact_moments_add(&sum, &sums->first[1], y);
    exact_moments_add(&sum, &sums->first[2], z);
    exact_moments_mac(&sum, &sums->third[0], xx, x);
    exact_moments_mac(&sum, &sums->third[1], xx, y);
    exact_moments_mac(&sum, &sums->third[2], xx, z);
    exact_moments_mac(&sum, &sums->third[3], yy, x);
    exact_moments_mac(&sum, &sums->third[4], xy, z);
    exact_moments_mac(&sum, &sums->third[5], zz, x);
    exact_moments_mac(&sum, &sums->third[6], yy, y);
    exact_moments_mac(&sum, &sums->third[7], yy, z);
    exact_moments_mac(&sum, &sums->third[8], zz, y);
    exact_moments_mac(&sum, &sums->third[9], zz, z);
    const int32_t xz = x * z, yz = y * z;
    exact_moments_add(&sum, &sums->second[0], sign * xx);
    exact_moments_add(&sum, &sums->second[1], sign * xy);
    exact_moments_add(&sum, &sums->second[2], sign * xz);
    exact_moments_add(&sum, &sums->second[3], sign * yy);
    exact_moments_add(&sum, &sums->second[4], sign * yz);
    exact_moments_add(&sum, &sums->second[5], sign * zz);
    const int32_t sxx = sign * xx, syy = sign * yy, szz = sign * zz;
    exact_moments_mac(&sum, &sums->fourth[0], sxx, xx);
    exact_moments_mac(&sum, &sums->fourth[1], sxx, xy);
    exact_moments_mac(&sum, &sums->fourth[2], sxx, xz);
    exact_moments_mac(&sum, &sums->fourth[3], sxx, yy);
    exact_moments_mac(&sum, &sums->fourth[4], sxx, yz);
    exact_moments_mac(&sum, &sums->fourth[5], sxx, zz);
    exact_moments_mac(&sum, &sums->fourth[6], syy, xy);
    exact_moments_mac(&sum, &sums->fourth[7], syy, xz);
    exact_moments_mac(&sum, &sums->fourth[8], szz, xy);
    exact_moments_mac(&sum, &sums->fourth[9], szz, xz);
    exact_moments_mac(&sum, &sums->fourth[10], syy, yy);
    exact_moments_mac(&sum, &sums->fourth[11], syy, yz);
    exact_moments_mac(&sum, &sums->fourth[12], syy, zz);
    exact_moments_mac(&sum, &sums->fourth[13], szz, yz);
    exact_moments_mac(&sum, &sums->fourth[14], szz, zz);
    sum.home[0] = sum.low;
    sum.home[1] = sum.high;
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
