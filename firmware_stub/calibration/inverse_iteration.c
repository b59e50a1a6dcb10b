/**
 * @file inverse_iteration.c
 * @brief `inverse-iteration`: the fit of `iterative`, whose eigenvector is found by inverse iteration instead of Jacobi's rotations.
 *
 * The eigenvector of the smallest eigenvalue of the 10x10 scatter matrix S is the limit of `S w = v`, `v = w / |w|` (Wielandt's inverse
 * iteration: Golub and Van Loan, Matrix Computations, 4th edition, section 7.6.1). S is factored once, as L D L^T. The iteration begins at
 * the quadric of `direct`, which is close, and each solution reduces its error by the ratio of the two smallest eigenvalues: with little
 * noise and a whole sphere a thousandth. Jacobi's rotations find all ten eigenvectors, of which nine are not used.
 */
#include "fast_code.h"
#include "fit_result.h"
#include "ten_elements.h"

#define ITERATION_LIMIT 32

/* Squared change of a unit vector at which the iteration ends; rounding alone makes about 1e-13. */
#define NEGLIGIBLE 1.0e-11f

/* The stand-in for a pivot that vanishes, as part of the matrix' first element. */
#define SMALLEST_PIVOT 1.0e-9f

/* Factor in place: `upper` holds L' then, and `values` the reciprocals of the pivots. Without noise the last pivot is rounding, of either
 * sign: what it makes large is along the vector that is wanted. */
static FAST_CODE void factor(jacobi_t *m)
{
    const float smallest = SMALLEST_PIVOT * m->values[0];
    for (int k = 0; k < TEN_ELEMENTS; k++) {
        const float pivot = m->values[k];
        const float reciprocal = 1.0f / (__builtin_fabsf(pivot) > smallest ? pivot : smallest);
        for (int i = k + 1; i < TEN_ELEMENTS; i++) {
            const float scaled = m->upper[k][i] * reciprocal;
            m->values[i] -= scaled * m->upper[k][i];
            for (int j = i + 1; j < TEN_ELEMENTS; j++) {
                m->upper[i][j] -= scaled * m->upper[k][j];
            }
            m->upper[k][i] = scaled;
        }
        m->values[k] = reciprocal;
    }
}

/* Solve for a vector in place. */
static FAST_CODE void solve(const jacobi_t *m, float w[TEN_ELEMENTS])
{
    for (int k = 0; k < TEN_ELEMENTS; k++) {
        for (int i = k + 1; i < TEN_ELEMENTS; i++) {
            w[i] -= m->upper[k][i] * w[k];
        }
        w[k] *= m->values[k];
    }
    for (int k = TEN_ELEMENTS - 2; k >= 0; k--) {
        for (int i = k + 1; i < TEN_ELEMENTS; i++) {
            w[k] -= m->upper[k][i] * w[i];
        }
    }
}

/* Replace a vector by the unit vector along another one, in the direction nearer to it; returns the square of its change. */
static FAST_CODE float replace(float v[TEN_ELEMENTS], const float w[TEN_ELEMENTS])
{
    float square = 0.0f, dot = 0.0f, change = 0.0f;
    for (int i = 0; i < TEN_ELEMENTS; i++) {
        square += w[i] * w[i];
        dot += w[i] * v[i];
    }
    const float length = __builtin_sqrtf(square), scale = 1.0f / (has_minus(dot) ? -length : length);
    for (int i = 0; i < TEN_ELEMENTS; i++) {
        const float next = scale * w[i], difference = next - v[i];
        change += difference * difference;
        v[i] = next;
    }
    return change;
}

FAST_CODE void magnetometer_inverse_iteration(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    ten_elements_t ten;
    float v[TEN_ELEMENTS], w[TEN_ELEMENTS];

    if (!ten_elements_begin(points, &ten, fit)) {
        return;
    }
    const quadric_t *const q = &ten.least_squares.quadric;
    const float unit = ten.unit;
    const float start[TEN_ELEMENTS] = {
        unit * q->shape.xx, unit * q->shape.xy, unit * q->shape.xz, unit * q->shape.yy, unit * q->shape.yz,
        unit * q->shape.zz, q->linear[0],       q->linear[1],       q->linear[2],       q->constant / unit};
    for (int i = 0; i < TEN_ELEMENTS; i++) {
        v[i] = start[i];
    }
    (void)replace(v, start);
    factor(&ten.matrix);
    const uint16_t limit = points->iterations == 0u || points->iterations > ITERATION_LIMIT ? ITERATION_LIMIT : points->iterations;
    bool ended = false;
    while (!ended && fit->iterations < limit) {
        for (int i = 0; i < TEN_ELEMENTS; i++) {
            w[i] = v[i];
        }
        solve(&ten.matrix, w);
        ended = replace(v, w) < NEGLIGIBLE;
        fit->iterations++;
    }
    ten_elements_end(v, ended, &ten, fit);
}
