/**
 * @file gravity_equations.h
 * @brief The part that `dpi` and `joint` share: twelve unknowns of a gain and a constant, their equations, and the calibration from them.
 *
 * Unknowns are in the order of a 3x4 matrix: for each component of the corrected field its constant and its three gains.
 */
#ifndef HILTEST_GRAVITY_EQUATIONS_H
#define HILTEST_GRAVITY_EQUATIONS_H

#include "magnetometer_calibrator.h"

#define GRAVITY_UNKNOWNS 12

/** The stand-in for the coverage when a pivot vanishes; of `dpi` the last one falls with the square of the dip besides. */
#define LAST_PIVOT_LIMIT 1.0e6f

/** Rows 0..11 are the normal equations' lower triangle, row 12 the target. */
typedef float gravity_equations_t[GRAVITY_UNKNOWNS + 1][GRAVITY_UNKNOWNS];

/** `corrected = x[0] + gain (counts - anchor) / unit`, for each row of x. */
typedef struct {
    const float *x;        /**< 12 unknowns */
    const float *adjugate; /**< of the gain, row-major */
    float determinant;     /**< of the gain */
    const float *anchor;   /**< [counts] */
    float unit;            /**< [counts] */
} gravity_solution_t;

/** The matrix that is subtracted from the equations while they are factored: `share border border'`; zeros where there is nothing. */
typedef struct {
    float reciprocals[GRAVITY_UNKNOWNS]; /**< of the pivots so far, then zeros */
    float border[GRAVITY_UNKNOWNS + 1];  /**< the last is the target's, zero */
    float share;
} gravity_column_t;

/**
 * Reduce a column: subtract from its element of each row the products of those before it and the first row's over the pivots, in
 * fours, and the border's.
 *
 * @param row the first one, in which the element is the diagonal's; all rows are finite up to the diagonal 4x4 block's end
 * @param rows how many, at least one
 * @param number of the column
 */
void gravity_reduce(float (*row)[GRAVITY_UNKNOWNS], const gravity_column_t *column, uint32_t rows, uint32_t number);

/**
 * Factor as L D L^T without pivoting, carrying the target along: row 12 then holds L^-1 times it. Diagonal 4x4 blocks must be finite as
 * a whole.
 *
 * @param column its border and share; the reciprocals are stored
 * @return coverage: largest ratio of the pivot that attitudes all round would have, with rows of mean square 1, to the one there is, the
 *         last left out; LAST_PIVOT_LIMIT when a pivot vanishes
 */
float gravity_factor(gravity_equations_t m, gravity_column_t *column);

/** Solve for the unknowns, by what gravity_factor() left. */
void gravity_substitute(gravity_equations_t m, const gravity_column_t *column, float x[GRAVITY_UNKNOWNS]);

/** Adjugate of the gain in x, row-major; returns its determinant. */
float gravity_adjugate(const float x[GRAVITY_UNKNOWNS], float adjugate[9]);

/** Store the calibration of a solution, its gain times `factor`. */
void gravity_store(const gravity_solution_t *solution, float factor, magnetometer_fit_t *fit);

#endif
