#include "unit_trace_products.h"

#include <stddef.h>

#include "fast_code.h"

#define ROWS (UNIT_TRACE_UNKNOWNS + 1)
#define SQRT_2 1.41421356f
#define ROOT_OF_HALF 0.70710678f
#define ROOT_OF_SIXTH 0.40824829f
#define THIRD 0.33333333f

/* First member of each degree in moments_t, and their end. */
#define FIRST_DEGREE 1u
#define SECOND_DEGREE 4u
#define THIRD_DEGREE 10u
#define FOURTH_DEGREE 20u

/* From the products with the six monomials of degree two to those with the five elements of T and the sixth row, down a column. Called
 * 16 times, and not worth 400 bytes of SRAM. */
static __attribute__((noinline)) FAST_CODE void combine(float xx, float yy, float zz, float xy, float xz, float yz, float column[])
{
    column[0] = ROOT_OF_HALF * (xx - yy);
    column[1 * ROWS] = ROOT_OF_SIXTH * ((xx - zz) + (yy - zz));
    column[2 * ROWS] = SQRT_2 * xy;
    column[3 * ROWS] = SQRT_2 * xz;
    column[4 * ROWS] = SQRT_2 * yz;
    column[5 * ROWS] = THIRD * (xx + yy + zz);
}

/* Moments of coordinates divided by `unit`. */
static FAST_CODE void scale(const moments_t *sums, float unit, moments_t *scaled)
{
    const float *const from = (const float *)sums;
    float *const to = (float *)scaled;
    const float first = 1.0f / unit;
    float factor = 1.0f;
    for (size_t i = 0; i < MOMENTS_FLOATS; i++) {
        if (i == FIRST_DEGREE || i == SECOND_DEGREE || i == THIRD_DEGREE || i == FOURTH_DEGREE) {
            factor *= first;
        }
        to[i] = factor * from[i];
    }
}

FAST_CODE void unit_trace_products(const moments_t *sums, float unit, products_t products)
{
    moments_t scaled;
    const moments_t *const s = &scaled;
    float once[6][ROWS]; /* row: element of T, or the sixth; column: monomial of degree two */
    scale(sums, unit, &scaled);

    products[0][0] = s->one;
    products[1][0] = s->x;
    products[2][0] = s->y;
    products[3][0] = s->z;
    products[1][1] = s->xx;
    products[2][1] = s->xy;
    products[3][1] = s->xz;
    products[2][2] = s->yy;
    products[3][2] = s->yz;
    products[3][3] = s->zz;
    float(*const below)[ROWS] = &products[UNIT_TRACE_SHAPE];
    combine(s->xx, s->yy, s->zz, s->xy, s->xz, s->yz, &below[0][0]);
    combine(s->xxx, s->xyy, s->xzz, s->xxy, s->xxz, s->xyz, &below[0][1]);
    combine(s->xxy, s->yyy, s->yzz, s->xyy, s->xyz, s->yyz, &below[0][2]);
    combine(s->xxz, s->yyz, s->zzz, s->xyz, s->xzz, s->yzz, &below[0][3]);

    combine(s->xxxx, s->xxyy, s->xxzz, s->xxxy, s->xxxz, s->xxyz, &once[0][0]);
    combine(s->xxyy, s->yyyy, s->yyzz, s->xyyy, s->xyyz, s->yyyz, &once[0][1]);
    combine(s->xxzz, s->yyzz, s->zzzz, s->xyzz, s->xzzz, s->yzzz, &once[0][2]);
    combine(s->xxxy, s->xyyy, s->xyzz, s->xxyy, s->xxyz, s->xyyz, &once[0][3]);
    combine(s->xxxz, s->xyyz, s->xzzz, s->xxyz, s->xxzz, s->xyzz, &once[0][4]);
    combine(s->xxyz, s->yyyz, s->yzzz, s->xyyz, s->xyzz, s->yyzz, &once[0][5]);
    for (int i = 0; i < 6; i++) {
        const float *const of = once[i];
        combine(of[0], of[1], of[2], of[3], of[4], of[5], &below[0][UNIT_TRACE_SHAPE + i]);
    }
}

FAST_CODE bool products_eliminate(products_t m, int first, int last)
{
    for (int j = first; j < last; j++) {
        if (!(m[j][j] > 0.0f)) {
            return false;
        }
        const float reciprocal = 1.0f / m[j][j];
        for (int k = j + 1; k < ROWS; k++) {
            const float scaled = m[k][j] * reciprocal;
            for (int i = k; i < ROWS; i++) {
                m[i][k] -= m[i][j] * scaled;
            }
            m[k][j] = scaled;
        }
    }
    return true;
}

FAST_CODE void products_substitute(const products_t m, int first, int last, float x[UNIT_TRACE_UNKNOWNS + 1])
{
    for (int i = last - 1; i >= first; i--) {
        float sum = 0.0f;
        for (int k = i + 1; k < ROWS; k++) {
            sum += m[k][i] * x[k];
        }
        x[i] = -sum;
    }
}

FAST_CODE void unit_trace_quadric(const float x[UNIT_TRACE_UNKNOWNS], float unit, quadric_t *quadric)
{
    const float *const t = &x[UNIT_TRACE_SHAPE];
    const float across = ROOT_OF_HALF * t[0], along = ROOT_OF_SIXTH * t[1];
    quadric->shape = (symmetric_t){
        .xx = THIRD + along + across, .yy = THIRD + along - across, .zz = THIRD - 2.0f * along,
        .xy = ROOT_OF_HALF * t[2], .xz = ROOT_OF_HALF * t[3], .yz = ROOT_OF_HALF * t[4]};
    for (int axis = 0; axis < 3; axis++) {
        quadric->linear[axis] = unit * x[1 + axis];
    }
    quadric->constant = unit * unit * x[0];
}
