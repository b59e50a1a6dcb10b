/* The 10-element fit as the public sensor-fusion libraries do it, over a fixed set of points: the quadric of unit norm with the
 * smallest algebraic error is the eigenvector of the smallest eigenvalue of the 10x10 scatter matrix. Written from the
 * description of the method. Two things are cheaper than there: the scatter matrix is built from its 34 different sums, and
 * coordinates are anchored at the middle of their range and scaled to it, which float32 likes better than the first point. */
#include <stdbool.h>

#include "fast_code.h"
#include "fit_result.h"
#include "jacobi.h"
#include "quadric.h"

#define ELEMENTS 10

/* A second eigenvalue below this part of the trace is rounding: more than one quadric passes through the points. */
#define SECOND_SMALLEST 1.0e-6f

/* Scatter matrix of (xx, xy, xz, yy, yz, zz, x, y, z, 1), in counts. */
static FAST_CODE void assemble(const moments_t *s, jacobi_t *m)
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
static FAST_CODE void scale(float unit, jacobi_t *m)
{
    const float first = 1.0f / unit, second = first * first;
    const float factor[ELEMENTS] = {second,        2.0f * second, 2.0f * second, second, 2.0f * second,
                                    second,        first,         first,         first,  1.0f};
    for (int i = 0; i < ELEMENTS; i++) {
        m->values[i] *= factor[i] * factor[i];
        for (int j = i + 1; j < ELEMENTS; j++) {
            m->upper[i][j] *= factor[i] * factor[j];
        }
    }
}

/* Half of the widest range [counts]. */
static FAST_CODE float half_range(const magnetometer_points_t *points)
{
    int32_t widest = 0;
    for (int axis = 0; axis < 3; axis++) {
        const int32_t range = points->maximum[axis] - points->minimum[axis];
        widest = range > widest ? range : widest;
    }
    return 0.5f * (float)widest;
}

/* Index of the smallest eigenvalue; false when it is not the only one near zero. */
static FAST_CODE bool smallest(const jacobi_t *m, int *index)
{
    int lowest = 0;
    float trace = 0.0f, second = __builtin_huge_valf();
    for (int i = 0; i < ELEMENTS; i++) {
        trace += m->values[i];
        if (m->values[i] < m->values[lowest]) {
            lowest = i;
        }
    }
    for (int i = 0; i < ELEMENTS; i++) {
        if (i != lowest && m->values[i] < second) {
            second = m->values[i];
        }
    }
    *index = lowest;
    return second > SECOND_SMALLEST * trace;
}

/* The quadric in counts and of unit trace; false when its trace is zero, which no ellipsoid's is. */
static FAST_CODE bool quadric_from_vector(const float v[ELEMENTS], float unit, quadric_t *quadric)
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

/* factor * sqrt(a) by the eigenvectors of a. */
static FAST_CODE void square_root_by_rotations(const symmetric_t *a, float factor, jacobi_t *work, float root[9])
{
    work->values[0] = a->xx;
    work->values[1] = a->yy;
    work->values[2] = a->zz;
    work->upper[0][1] = a->xy;
    work->upper[0][2] = a->xz;
    work->upper[1][2] = a->yz;
    (void)jacobi_diagonalise(work, 3, JACOBI_SWEEP_LIMIT);
    float scaled[3];
    for (int k = 0; k < 3; k++) {
        scaled[k] = factor * __builtin_sqrtf(work->values[k] > 0.0f ? work->values[k] : 0.0f);
    }
    for (int i = 0; i < 3; i++) {
        for (int j = i; j < 3; j++) {
            const float element = scaled[0] * work->vectors[0][i] * work->vectors[0][j] +
                                  scaled[1] * work->vectors[1][i] * work->vectors[1][j] +
                                  scaled[2] * work->vectors[2][i] * work->vectors[2][j];
            root[3 * i + j] = element;
            root[3 * j + i] = element;
        }
    }
}

/* Sweeps allowed: those asked for, within the solver's own limit. */
static inline uint16_t sweep_limit(uint16_t asked)
{
    return asked == 0u || asked > JACOBI_SWEEP_LIMIT ? JACOBI_SWEEP_LIMIT : asked;
}

FAST_CODE void magnetometer_iterative(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    int32_t anchor[3];
    moments_t sums;
    jacobi_t work;
    quadric_t quadric;
    ellipsoid_t ellipsoid;
    int index;

    fit->iterations = 0;
    fit->coverage = 0.0f;
    if (points->count < FIT_ELLIPSOID_UNKNOWNS) {
        fit_nothing(FIT_TOO_FEW_POINTS, fit);
        return;
    }
    const float unit = half_range(points);
    if (!(unit > 0.0f)) {
        fit_nothing(FIT_SINGULAR, fit);
        return;
    }
    moments_anchor(points, anchor);
    moments_sum(points, anchor, &sums);
    assemble(&sums, &work);
    scale(unit, &work);
    const uint16_t limit = sweep_limit(points->iterations);
    fit->iterations = jacobi_diagonalise(&work, ELEMENTS, limit);
    const bool ended = fit->iterations < limit;
    if (!smallest(&work, &index)) {
        fit_sphere(&sums, anchor, ended ? FIT_POOR_COVERAGE : FIT_NOT_CONVERGED, fit);
        return;
    }
    if (!quadric_from_vector(work.vectors[index], unit, &quadric) || !quadric_ellipsoid(&quadric, &ellipsoid)) {
        fit_sphere(&sums, anchor, ended ? FIT_NOT_AN_ELLIPSOID : FIT_NOT_CONVERGED, fit);
        return;
    }
    fit->status = ended ? FIT_ELLIPSOID : FIT_NOT_CONVERGED;
    fit->is_sphere = 0;
    for (int axis = 0; axis < 3; axis++) {
        fit->hard_iron[axis] = (float)anchor[axis] + ellipsoid.centre[axis];
    }
    square_root_by_rotations(&quadric.shape, 1.0f / __builtin_sqrtf(ellipsoid.level), &work, fit->soft_iron);
}
