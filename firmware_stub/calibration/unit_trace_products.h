/**
 * @file unit_trace_products.h
 * @brief Sums of the products of a quadric's rows in coordinates that do not depend on how the axes lie, and their elimination.
 *
 * A quadric of unit trace is `p' (I/3 + T) p + g . p + j` with T of trace zero. T's five elements are those of the orthonormal basis
 * of symmetric matrices without trace, so that a turned sensor has turned elements: `|T|^2` is the sum of their squares. The same basis
 * as in the float64 references.
 */
#ifndef HILTEST_UNIT_TRACE_PRODUCTS_H
#define HILTEST_UNIT_TRACE_PRODUCTS_H

#include <stdbool.h>

#include "moments.h"
#include "quadric.h"

/** Unknowns: j, g, and T from UNIT_TRACE_SHAPE on. Behind them the row of `|p|^2 / 3`, or of what else stands on the right. */
#define UNIT_TRACE_UNKNOWNS 9
#define UNIT_TRACE_SHAPE 4

/** Lower triangle of the sums over all points of the products of two rows; the right-hand side is the last row. */
typedef float products_t[UNIT_TRACE_UNKNOWNS + 1][UNIT_TRACE_UNKNOWNS + 1];

/**
 * Form the sums of products of (1, x, y, z, (xx-yy)/sqrt2, (xx+yy-2zz)/sqrt6, sqrt2 xy, sqrt2 xz, sqrt2 yz, |p|^2/3).
 *
 * @param sums moments about an anchor
 * @param unit what coordinates are divided by [counts]
 * @param[out] products [1], the lower triangle; of the rest nothing is said
 */
void unit_trace_products(const moments_t *sums, float unit, products_t products);

/**
 * Eliminate columns from all rows below them, the L D L^T factorisation without pivoting.
 *
 * @param[in,out] m from `first` on; in columns [first, last) L is left, behind them what remains
 * @return false when a pivot is not positive; then `m` is of no use
 */
bool products_eliminate(products_t m, int first, int last);

/** Solve for x[first] to x[last - 1] from L in these columns; x from `last` on is given, and x[9] = 1 for a right-hand side. */
void products_substitute(const products_t m, int first, int last, float x[UNIT_TRACE_UNKNOWNS + 1]);

/** The quadric of unit trace in counts that has these unknowns. */
void unit_trace_quadric(const float x[UNIT_TRACE_UNKNOWNS], float unit, quadric_t *quadric);

#endif
