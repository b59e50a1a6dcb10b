/**
 * @file normal_equations.h
 * @brief Linear least squares for a quadric of unit trace.
 */
#ifndef HILTEST_NORMAL_EQUATIONS_H
#define HILTEST_NORMAL_EQUATIONS_H

#include "moments.h"
#include "quadric.h"

/** The stand-in for M_ii/d_i when a pivot vanishes: float32 cannot tell larger ratios from rounding. */
#define COVERAGE_SINGULAR 1.0e6f

/** The unknowns but the constant, in their order. */
#define SOLUTION_UNKNOWNS 8

/** The solution of least squares, and its least determined error. */
typedef struct {
    quadric_t quadric;
    /** The constant's error moves the other unknowns by -weakest of it: the last row of L, solved for. */
    float weakest[SOLUTION_UNKNOWNS];
    float pivot_variance[SOLUTION_UNKNOWNS + 1]; /**< 1/d of each pivot; stored even if there is no solution */
} solution_t;

/**
 * Fit the quadric of unit trace by least squares.
 *
 * Mucciaccia 2020, eq. 44 to 48, with M99 of eq. 45 and the sum of eq. 46 corrected (direct.c).
 *
 * The 9x9 normal equations are factored as L D L^T without pivoting, in the order (x^2-z^2, y^2-z^2, xy, xz, yz, x, y, z, 1).
 *
 * @param sums moments about the mid-range
 * @param[out] solution all but the pivots are untouched when there is none
 * @return largest M_ii/d_i over the pivots (1 when all columns are orthogonal), or COVERAGE_SINGULAR when there is no solution
 */
float quadric_fit(const moments_t *sums, solution_t *solution);

#endif
