#include "ten_elements.h"

#include "closed_form.h"
#include "fast_code.h"

/* A second eigenvalue below this part of the trace is rounding: more than one quadric passes through the points. */
#define SECOND_SMALLEST 1.0e-6f

/* Scatter matrix of (xx, xy, xz, yy, yz, zz, x, y, z, 1), in counts. */
static inline __attribute__((always_inline)) void assemble(const moments_t *s, jacobi_t *m)
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
static inline __attribute__((always_inline)) void scale_elements(float unit, jacobi_t *m)
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

FAST_CODE void ten_elements_matrix(const moments_t *sums, float unit, jacobi_t *matrix)
{
    assemble(sums, matrix);
    scale_elements(unit, matrix);
}

FAST_CODE bool smallest_eigenvalue(const jacobi_t *m, int size, int *index)
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

FAST_CODE bool quadric_from_vector(const float v[TEN_ELEMENTS], float unit, quadric_t *quadric)
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

FAST_CODE bool ten_elements_begin(const magnetometer_points_t *points, ten_elements_t *fit_state, magnetometer_fit_t *fit)
{
    moments_t sums;

    fit->iterations = 0;
    fit->coverage = 0.0f;
    if (points->count < FIT_ELLIPSOID_UNKNOWNS) {
        fit_nothing(FIT_TOO_FEW_POINTS, fit);
        return false;
    }
    fit_state->unit = half_range(points);
    if (!(fit_state->unit > 0.0f)) {
        fit_nothing(FIT_SINGULAR, fit);
        return false;
    }
    moments_anchor(points, fit_state->anchor);
    moments_sum(points, fit_state->anchor, &sums);
    if (!fit_ellipsoid(&sums, BIAS_OF_LEAST_SQUARES, &fit_state->least_squares, &fit_state->ellipsoid, fit)) {
        return false;
    }
    ten_elements_matrix(&sums, fit_state->unit, &fit_state->matrix);
    return true;
}

FAST_CODE void ten_elements_end(const float vector[TEN_ELEMENTS], bool ended, ten_elements_t *fit_state, magnetometer_fit_t *fit)
{
    quadric_t *const quadric = &fit_state->least_squares.quadric;
    if (!quadric_from_vector(vector, fit_state->unit, quadric) || !quadric_ellipsoid(quadric, &fit_state->ellipsoid)) {
        fit_nothing(FIT_NOT_AN_ELLIPSOID, fit);
        return;
    }
    fit_calibration(quadric, &fit_state->ellipsoid, fit_state->anchor, ended ? FIT_ELLIPSOID : FIT_NOT_CONVERGED, fit);
}
