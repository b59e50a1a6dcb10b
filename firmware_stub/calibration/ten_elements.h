/**
 * @file ten_elements.h
 * @brief The steps of the 10-element fit around its eigenvectors, for the calibrators that make it.
 *
 * The quadric of unit norm with the smallest algebraic error is the eigenvector of the smallest eigenvalue of the scatter matrix of
 * (xx, 2xy, 2xz, yy, 2yz, zz, x, y, z, 1), coordinates anchored and divided by a unit that makes all elements about as large as
 * the last. Inline, so that each calibrator is compiled whole.
 */
#ifndef HILTEST_TEN_ELEMENTS_H
#define HILTEST_TEN_ELEMENTS_H

#include "jacobi.h"
#include "moments.h"
#include "quadric.h"

#define TEN_ELEMENTS 10

/* A second eigenvalue below this part of the trace is rounding: more than one quadric passes through the points. */
#define SECOND_SMALLEST 1.0e-6f

#define TEN_ELEMENTS_INLINE static inline __attribute__((always_inline))

/* Scatter matrix of (xx, xy, xz, yy, yz, zz, x, y, z, 1), in counts. */
TEN_ELEMENTS_INLINE void ten_elements_assemble(const moments_t *s, jacobi_t *m)
{
    float(*const u)[JACOBI_LARGEST] = m->upper;
    u[0][1] = s->xxxy; u[0][2] = s->xxxz; u[0][3] = s->xxyy; u[0][4] = s->xxyz; u[0][5] = s->xxzz; u[0][6] = s->xxx;
    u[0][7] = s->xxy; u[0][8] = s->xxz; u[0][9] = s->xx;
    u[1][2] = s->xxyz; u[1][3] = s->xyyy; u[1][4] = s->xyyz; u[1][5] = s->xyzz; u[1][6] = s->xxy; u[1][7] = s->xyy;
    u[1][8] = s->xyz; u[1][9] = s->xy;
    u[2][3] = s->xyyz; u[2][4] = s->xyzz; u[2][5] = s->xzzz; u[2][6] = s->xxz; u[2][7] = s->xyz; u[2][8] = s->xzz;
    u[2][9] = s->xz;
    u[3][4] = s->yyyz; u[3][5] = s->yyzz; u[3][6] = s->xyy; u[3][7] = s->yyy; u[3][8] = s->yyz; u[3][9] = s->yy;
    u[4][5] = s->yzzz; u[4][6] = s->xyz; u[4][7] = s->yyz; u[4][8] = s->yzz; u[4][9] = s->yz;
    u[5][6] = s->xzz; u[5][7] = s->yzz; u[5][8] = s->zzz; u[5][9] = s->zz;
    u[6][7] = s->xy; u[6][8] = s->xz; u[6][9] = s->x;
    u[7][8] = s->yz; u[7][9] = s->y;
    u[8][9] = s->z;
    m->values[0] = s->xxxx; m->values[1] = s->xxyy; m->values[2] = s->xxzz; m->values[3] = s->yyyy;
    m->values[4] = s->yyzz; m->values[5] = s->zzzz; m->values[6] = s->xx; m->values[7] = s->yy; m->values[8] = s->zz;
    m->values[9] = s->one;
}

/* Change the elements to (xx, 2xy, 2xz, yy, 2yz, zz, x, y, z, 1) of coordinates divided by `unit`. The 2 makes the norm of the
 * cross terms that of a symmetric matrix; the unit makes all elements about as large as the last. */
TEN_ELEMENTS_INLINE void ten_elements_scale(float unit, jacobi_t *m)
{
    const float first = 1.0f / unit, second = first * first;
    const float factor[TEN_ELEMENTS] = {second,        2.0f * second, 2.0f * second, second, 2.0f * second,
                                    second,        first,         first,         first,  1.0f};
    for (int i = 0; i < TEN_ELEMENTS; i++) {
        m->values[i] *= factor[i] * factor[i];
        for (int j = i + 1; j < TEN_ELEMENTS; j++) {
            m->upper[i][j] *= factor[i] * factor[j];
        }
    }
}

/* Index of the smallest eigenvalue; false when it is not the only one near zero. */
TEN_ELEMENTS_INLINE bool smallest_eigenvalue(const jacobi_t *m, int size, int *index)
{
    int lowest = 0;
    float trace = 0.0f, second = __builtin_huge_valf();
    for (int i = 0; i < size; i++) {
        trace += m->values[i];
        if (m->values[i] < m->values[lowest]) {
            lowest = i;
        }
    }
    for (int i = 0; i < size; i++) {
        if (i != lowest && m->values[i] < second) {
            second = m->values[i];
        }
    }
    *index = lowest;
    return second > SECOND_SMALLEST * trace;
}

/* The quadric in counts and of unit trace; false when its trace is zero, which no ellipsoid's is. */
TEN_ELEMENTS_INLINE bool quadric_from_vector(const float v[TEN_ELEMENTS], float unit, quadric_t *quadric)
{
    const float trace = v[0] + v[3] + v[5];
    if (!(__builtin_fabsf(trace) > 1.0e-6f)) {
        return false;
    }
    const float a = 1.0f / trace, linear = a * unit;
    quadric->shape = (symmetric_t){a * v[0], a * v[1], a * v[2], a * v[3], a * v[4], a * v[5]};
    quadric->linear[0] = linear * v[6];
    quadric->linear[1] = linear * v[7];
    quadric->linear[2] = linear * v[8];
    quadric->constant = linear * unit * v[9];
    return true;
}

#endif
