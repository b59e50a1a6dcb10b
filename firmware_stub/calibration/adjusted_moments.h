/**
 * @file adjusted_moments.h
 * @brief The 34 moments as they are expected without noise, and the variance of the noise that a quadric fitted to them implies.
 *
 * Noise in the points is noise in the rows of the equations too: the algebraic fit is biased. Adjusted least squares (Kukush,
 * Markovsky and Van Huffel, Consistent estimation in an implicit quadratic measurement error model, 2004) takes that bias out of
 * the sums, which costs nothing per point.
 */
#ifndef HILTEST_ADJUSTED_MOMENTS_H
#define HILTEST_ADJUSTED_MOMENTS_H

#include "moments.h"
#include "quadric.h"

/**
 * Take the expected part of noise out of moments.
 *
 * With x = x0 + n, n normal with variance s, the Hermite polynomials of variance s
 * `[x^2] = x^2 - s, [x^3] = x^3 - 3 s x, [x^4] = x^4 - 6 s x^2 + 3 s^2` have the expectations x0^2, x0^3, x0^4; noise of the axes is
 * independent, so `[x^i y^j z^k] = [x^i] [y^j] [z^k]`. All are linear in the moments, about any anchor.
 *
 * @param sums moments
 * @param variance s, of each axis [counts^2]
 * @param[out] adjusted all of them, also those that noise leaves alone
 */
void moments_adjust(const moments_t *sums, float variance, moments_t *adjusted);

/**
 * Return by how much the variance must grow for the quadric to pass through the true points: Newton's step.
 *
 * The right variance is where J(s), the smallest sum [D^2] of the squares of `D(p) = p' A p + g . p + j`, is zero. As
 * `d[m]/ds = -1/2 [laplacian m]`, and D's laplacian is 2 tr A = 2 and [sum D] zero at the minimum, `J'(s) = -[sum |grad D|^2]`:
 * the step is `[sum D^2] / [sum |grad D|^2]`. D is orthogonal to all nine columns that it was fitted to, so `[sum D^2] = [sum D z^2]`.
 *
 * @param adjusted moments that the quadric was fitted to
 * @param quadric the solution
 * @return step [counts^2]; not finite when the points determine none
 */
float moments_noise_step(const moments_t *adjusted, const quadric_t *quadric);

/**
 * Return `[sum |grad D|^2] = 4 (sum A^2 . [p p'] + (A g) . [sum p]) + n g . g`.
 *
 * @param adjusted moments
 * @param quadric D
 * @return sum [counts^2]
 */
float moments_squared_slopes(const moments_t *adjusted, const quadric_t *quadric);

/**
 * Return sum D z^2, which for D fitted by least squares is sum D^2.
 *
 * @param sums moments that the quadric was fitted to
 * @param quadric D
 * @return sum [counts^4]
 */
float moments_residual(const moments_t *sums, const quadric_t *quadric);

#endif
