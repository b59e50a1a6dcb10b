/**
 * @file li.c
 * @brief `li`: the ellipsoid-specific fit, least squares under Li and Griffiths' constraint.
 *
 * Li and Griffiths, Least squares ellipsoid specific fitting, 2004, theorem 1 and eq. 9 to 15: the algebraic error is least under
 * `4 J - I^2 = 1`, with `I = tr A` and `J` the sum of A's principal minors, and every quadric with `4 J - I^2 > 0` is an ellipsoid. None
 * whose shortest axis is below about half of the longest is among them: such points are fitted by another one, noise or not.
 *
 * Of A = s (I/3 + T), T without trace, `4 J - I^2 = s^2 (1/3 - 2 |T|^2)`. With `f(T)` the least error for s = 1, which is that of the
 * fit of direct.c at its T, the fit makes `f / c` least, c = 1/3 - 2 |T|^2. So their eigenvalue problem (eq. 15) is one in a single
 * unknown: where L is the ratio, T makes `f - L c` least, a linear problem whose matrix is the one of `direct` with 2 L on the diagonal.
 * `f - L c` at that T is concave in L, and Newton's steps (Dinkelbach 1967) come down from the L of any sphere to the only root, whatever
 * the signs: noiseless points, where the eigenvalue problem has a singular matrix, have L = 0 and the fit of `direct`.
 *
 * Coverage is judged as in direct.c, by the pivots; the float64 reference judges it by the condition number.
 */
#include "closed_form.h"
#include "fast_code.h"
#include "unit_trace_products.h"

#define LAST UNIT_TRACE_UNKNOWNS

/* Over 2000 instances of the thesis' generator with 0.3 uT of noise 3 to 13, with more noise fewer; without noise, where the ratio is next
 * to zero, 2 took all and are within 0.02 degrees. */
#define STEPS 32

/* A step that lowers the ratio by less leaves less than float32 resolves of T, or is rounding. */
#define SETTLED 1.0e-5f

/* Find j, g and T with s = 1; false when there are none. The fit of T at each ratio begins with the products that j and g leave. */
static FAST_CODE bool solve(products_t m, float x[LAST + 1])
{
    float rest[LAST + 1 - UNIT_TRACE_SHAPE][LAST + 1];
    if (!products_eliminate(m, 0, UNIT_TRACE_SHAPE)) {
        return false;
    }
    for (int i = UNIT_TRACE_SHAPE; i <= LAST; i++) {
        for (int j = UNIT_TRACE_SHAPE; j <= i; j++) {
            rest[i - UNIT_TRACE_SHAPE][j] = m[i][j];
        }
    }
    float ratio = 3.0f * m[LAST][LAST]; /* of the spheres */
    for (int step = 0; step < STEPS; step++) {
        for (int i = UNIT_TRACE_SHAPE; i <= LAST; i++) {
            for (int j = UNIT_TRACE_SHAPE; j <= i; j++) {
                m[i][j] = rest[i - UNIT_TRACE_SHAPE][j];
            }
        }
        for (int i = UNIT_TRACE_SHAPE; i < LAST; i++) {
            m[i][i] += 2.0f * ratio;
        }
        m[LAST][LAST] -= ratio / 3.0f;
        if (!products_eliminate(m, UNIT_TRACE_SHAPE, LAST)) {
            return false;
        }
        products_substitute(m, UNIT_TRACE_SHAPE, LAST, x);
        float squares = 0.0f;
        for (int i = UNIT_TRACE_SHAPE; i < LAST; i++) {
            squares += x[i] * x[i];
        }
        const float constraint = 1.0f / 3.0f - 2.0f * squares;
        if (!(constraint > 0.0f)) {
            return false;
        }
        const float down = ratio + m[LAST][LAST] / constraint, next = down > 0.0f ? down : 0.0f;
        if (!(next < (1.0f - SETTLED) * ratio)) {
            break;
        }
        ratio = next;
    }
    products_substitute(m, 0, UNIT_TRACE_SHAPE, x);
    return true;
}

FAST_CODE void magnetometer_li(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    int32_t anchor[3];
    moments_t sums;
    solution_t solution;
    quadric_t quadric;
    ellipsoid_t ellipsoid;
    products_t products;
    float x[LAST + 1];

    fit->iterations = 0;
    fit->coverage = 0.0f;
    if (points->count < FIT_ELLIPSOID_UNKNOWNS) {
        fit_nothing(FIT_TOO_FEW_POINTS, fit);
        return;
    }
    moments_anchor(points, anchor);
    moments_sum(points, anchor, &sums);
    if (!fit_ellipsoid(&sums, BIAS_OF_LEAST_SQUARES, &solution, &ellipsoid, fit)) {
        return;
    }
    const float unit = __builtin_sqrtf((sums.xx + sums.yy + sums.zz) / sums.one);
    unit_trace_products(&sums, unit, products);
    x[LAST] = 1.0f;
    if (!solve(products, x)) {
        fit_nothing(FIT_NOT_AN_ELLIPSOID, fit);
        return;
    }
    unit_trace_quadric(x, unit, &quadric);
    if (!quadric_ellipsoid(&quadric, &ellipsoid)) {
        fit_nothing(FIT_NOT_AN_ELLIPSOID, fit);
        return;
    }
    fit_calibration(&quadric, &ellipsoid, anchor, FIT_ELLIPSOID, fit);
}
