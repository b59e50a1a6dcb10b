/**
 * @file square_root.h
 * @brief The symmetric square root of a 3x3 matrix in closed form.
 *
 * Hoger and Carlson, Determination of the stretch and rotation in the polar decomposition of the deformation gradient, Quarterly of
 * Applied Mathematics 42, 1984. It replaces the eigenvectors of Mucciaccia 2020, eq. 51 to 53.
 */
#ifndef HILTEST_SQUARE_ROOT_H
#define HILTEST_SQUARE_ROOT_H

#include "quadric.h"

/**
 * Form the positive definite square root of a symmetric positive definite matrix of unit trace.
 *
 * With p, q, r the invariants (trace, sum of principal minors, determinant) of the root, Cayley-Hamilton gives
 * `root = ((p^2 - q) A + p r I - A^2) / (p q - r)`. r is the root of det A; q = (p^2 - 1)/2; and p is the largest solution of
 * `(p^2 - 1)^2 - 8 r p = 4 minors`, found by Newton's method from above.
 *
 * @param a matrix, trace 1
 * @param minors sum of its principal 2x2 minors
 * @param determinant of it, at least 1e-6
 * @param factor multiplies the result
 * @param[out] root factor times the square root, row-major 3x3
 */
void symmetric_square_root(const symmetric_t *a, float minors, float determinant, float factor, float root[9]);

#endif
