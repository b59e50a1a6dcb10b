/**
 * @file moments.h
 * @brief The 34 sums of all monomials of degree 1 to 4 in three coordinates.
 *
 * Every algebraic fit of a quadric needs these sums and nothing else of the points. The 81 sums of Mucciaccia's thesis (2020), eq. 45
 * and 46, are differences of these 34.
 */
#ifndef HILTEST_MOMENTS_H
#define HILTEST_MOMENTS_H

#include "magnetometer_calibrator.h"

/** Sums over all points of the monomial each member is named after, coordinates relative to the anchor [counts^degree]. */
typedef struct {
    float one; /**< number of points */
    float x, y, z;
    float xx, xy, xz, yy, yz, zz;
    float xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz;
    float xxxx, xxxy, xxxz, xxyy, xxyz, xxzz, xyyy, xyyz, xyzz, xzzz, yyyy, yyyz, yyzz, yzzz, zzzz;
} moments_t;

/** The count and the sums, which several functions go through as one array of floats. */
#define MOMENTS_FLOATS 35u
_Static_assert(sizeof(moments_t) == MOMENTS_FLOATS * sizeof(float), "moments_t must be an array of floats without gaps");

/**
 * Choose the middle of the points' range as the origin of the sums.
 *
 * float32 holds the sums only near the points: with a hard iron of 10 times the field, sums about zero lose the fit entirely.
 * The mid-range also makes the pivots of the normal equations tell coverage; the first point would not.
 *
 * @param points range of the points
 * @param[out] anchor x, y, z [counts], halves truncated towards zero
 */
void moments_anchor(const magnetometer_points_t *points, int32_t anchor[3]);

/**
 * Sum the monomials of all points about an anchor.
 *
 * @param points points to sum
 * @param anchor origin of the sums [counts]
 * @param[out] sums the 34 moments and the count
 */
void moments_sum(const magnetometer_points_t *points, const int32_t anchor[3], moments_t *sums);

/** Add sums about the same anchor. */
void moments_merge(moments_t *into, const moments_t *from);

#endif
