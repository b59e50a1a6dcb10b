/**
 * @file gradient_descent.c
 * @brief `gradient-descent`: the algebraic error of unit trace by steepest descent, kept to ellipsoids.
 *
 * Mucciaccia's thesis (2020), section 4.2.1, evaluates a simple gradient descent that is kept to ellipsoids, with the algebraic distance,
 * but does not say how. Here each step goes down the gradient of the error by 1 over its largest curvature, and A's eigenvalues are then
 * moved to the nearest ones that add up to 1 and are none below 0.01: no axis is longer than ten times another. That set is convex and
 * closed, so there is one minimum and the descent reaches it: that of direct.c where the set holds it, else an ellipsoid on its edge. (That
 * no constrained algorithm is optimal, section 3.3.3, is so for the open set of all ellipsoids.)
 *
 * The points enter by their moments alone: a step costs the same for any number of them. With smallest and largest curvature l and L a
 * step of length h ends within `2 h L / l` of the minimum.
 */
#include "closed_form.h"
#include "fast_code.h"
#include "jacobi.h"
#include "unit_trace_products.h"

#define UNKNOWNS UNIT_TRACE_UNKNOWNS
#define SHAPE UNIT_TRACE_SHAPE

/* As in the float64 reference: the largest condition with which points determine an ellipsoid (a whole sphere has 7.5, half of one about
 * 105), the smallest eigenvalue, and how near to the minimum the descent ends, in parameters of size 1. Points of condition 250 take 2700
 * steps. */
#define LARGEST_CONDITION 300.0f
#define LEAST_EIGENVALUE 0.01f
#define NEAR 1.0e-5f
#define STEPS 10000

/* float32 rounds parameters of size 1 by this; nothing shorter is a step. Of points of condition 50 or less it decides nothing. */
#define SHORTEST_STEP 1.0e-7f

#define ROOT_OF_HALF 0.70710678f
#define ROOT_OF_SIXTH 0.40824829f

/** Gradient and what is known of its slope. */
typedef struct {
    products_t products; /**< of both halves, means over the points; the last row is the gradient at zero */
    float step;          /**< 1 over the largest curvature */
    float end;           /**< length of a step that ends the descent */
} descent_t;

/* The middle of the points, about which curvatures are the most alike. */
static FAST_CODE void mean(const magnetometer_points_t *points, int32_t anchor[3])
{
    int32_t sum[3] = {0, 0, 0};
    for (uint32_t at = 0; at < points->count; at++) {
        for (int axis = 0; axis < 3; axis++) {
            sum[axis] += points->points[at][axis];
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        anchor[axis] = sum[axis] / (int32_t)points->count;
    }
}

/* Eigenvalues of the normal matrix; false when their ratio is too large. */
static FAST_CODE bool curvatures(descent_t *descent, jacobi_t *work)
{
    float(*const m)[UNKNOWNS + 1] = descent->products;
    for (int i = 0; i <= UNKNOWNS; i++) {
        for (int j = 0; j < i; j++) {
            m[j][i] = m[i][j];
        }
    }
    for (int i = 0; i < UNKNOWNS; i++) {
        work->values[i] = m[i][i];
        for (int j = i + 1; j < UNKNOWNS; j++) {
            work->upper[i][j] = m[i][j];
        }
    }
    jacobi_diagonalise(work, UNKNOWNS, JACOBI_SWEEP_LIMIT);
    float smallest = work->values[0], largest = smallest;
    for (int i = 1; i < UNKNOWNS; i++) {
        smallest = work->values[i] < smallest ? work->values[i] : smallest;
        largest = work->values[i] > largest ? work->values[i] : largest;
    }
    descent->step = 1.0f / largest;
    const float end = 0.5f * NEAR * smallest / largest;
    descent->end = end > SHORTEST_STEP ? end : SHORTEST_STEP;
    return smallest * LARGEST_CONDITION >= largest;
}

/* Values that are none below the least one and add up to 1, nearest to three that add up to 1. */
static FAST_CODE void nearest_values(float values[3])
{
    /* One is not below: what the others are raised by is taken from those that are above, in equal parts. */
    for (int pass = 0; pass < 2; pass++) {
        float missing = 0.0f;
        int above = 0;
        for (int i = 0; i < 3; i++) {
            if (values[i] <= LEAST_EIGENVALUE) {
                missing += LEAST_EIGENVALUE - values[i];
                values[i] = LEAST_EIGENVALUE;
            } else {
                above++;
            }
        }
        for (int i = 0; i < 3; i++) {
            if (values[i] > LEAST_EIGENVALUE) {
                values[i] -= missing / (float)above;
            }
        }
    }
}

/* Say whether no eigenvalue is below the least one. */
static inline bool is_inside(const symmetric_t *a)
{
    const float xx = a->xx - LEAST_EIGENVALUE, yy = a->yy - LEAST_EIGENVALUE, zz = a->zz - LEAST_EIGENVALUE;
    const float minor = xx * yy - a->xy * a->xy;
    const float determinant = zz * minor - xx * a->yz * a->yz - yy * a->xz * a->xz + 2.0f * a->xy * a->xz * a->yz;
    return xx > 0.0f && minor > 0.0f && determinant >= 0.0f;
}

/* Move the shape to the nearest one that is allowed. */
static FAST_CODE void nearest_ellipsoid(float x[UNKNOWNS], jacobi_t *work)
{
    quadric_t quadric;
    symmetric_t *const a = &quadric.shape;
    unit_trace_quadric(x, 1.0f, &quadric);
    if (is_inside(a)) {
        return;
    }
    work->values[0] = a->xx;
    work->values[1] = a->yy;
    work->values[2] = a->zz;
    work->upper[0][1] = a->xy;
    work->upper[0][2] = a->xz;
    work->upper[1][2] = a->yz;
    jacobi_diagonalise(work, 3, JACOBI_SWEEP_LIMIT);
    nearest_values(work->values);
    float t[5] = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    for (int i = 0; i < 3; i++) {
        const float value = work->values[i], *const v = work->vectors[i];
        t[0] += value * (v[0] * v[0] - v[1] * v[1]);
        t[1] += value * (v[0] * v[0] + v[1] * v[1] - 2.0f * v[2] * v[2]);
        t[2] += value * v[0] * v[1];
        t[3] += value * v[0] * v[2];
        t[4] += value * v[1] * v[2];
    }
    x[SHAPE] = ROOT_OF_HALF * t[0];
    x[SHAPE + 1] = ROOT_OF_SIXTH * t[1];
    for (int i = 2; i < 5; i++) {
        x[SHAPE + i] = 2.0f * ROOT_OF_HALF * t[i];
    }
}

/* Go down by one step; returns its length, squared. */
static FAST_CODE float go_down(const descent_t *descent, float x[UNKNOWNS], jacobi_t *work)
{
    float before[UNKNOWNS];
    for (int i = 0; i < UNKNOWNS; i++) {
        before[i] = x[i];
    }
    for (int i = 0; i < UNKNOWNS; i++) {
        const float *const row = descent->products[i];
        float slope = row[UNKNOWNS];
#pragma GCC unroll 9
        for (int j = 0; j < UNKNOWNS; j++) {
            slope += row[j] * before[j];
        }
        x[i] = before[i] - descent->step * slope;
    }
    nearest_ellipsoid(x, work);
    float square = 0.0f;
    for (int i = 0; i < UNKNOWNS; i++) {
        square += (x[i] - before[i]) * (x[i] - before[i]);
    }
    return square;
}

FAST_CODE void magnetometer_gradient_descent(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    int32_t anchor[3];
    moments_t sums;
    descent_t descent;
    jacobi_t work;
    solution_t solution;
    quadric_t quadric;
    ellipsoid_t ellipsoid;
    float x[UNKNOWNS];

    fit->iterations = 0;
    fit->coverage = 0.0f;
    if (points->count < FIT_ELLIPSOID_UNKNOWNS) {
        fit_nothing(FIT_TOO_FEW_POINTS, fit);
        return;
    }
    mean(points, anchor);
    moments_sum(points, anchor, &sums);
    const float unit = __builtin_sqrtf((sums.xx + sums.yy + sums.zz) / sums.one);
    if (!(unit > 0.0f)) {
        fit_nothing(FIT_SINGULAR, fit);
        return;
    }
    if (!fit_ellipsoid(&sums, BIAS_OF_LEAST_SQUARES, &solution, &ellipsoid, fit)) {
        return;
    }
    unit_trace_products(&sums, unit, descent.products);
    if (!curvatures(&descent, &work)) {
        fit_nothing(FIT_POOR_COVERAGE, fit);
        return;
    }
    const uint16_t limit = points->iterations == 0u || points->iterations > STEPS ? STEPS : points->iterations;
    for (int i = 0; i < UNKNOWNS; i++) {
        x[i] = 0.0f; /* a sphere about the mean */
    }
    bool settled = false;
    while (fit->iterations < limit && !settled) {
        settled = go_down(&descent, x, &work) <= descent.end * descent.end;
        fit->iterations++;
    }
    unit_trace_quadric(x, unit, &quadric);
    if (!quadric_ellipsoid(&quadric, &ellipsoid)) {
        fit_nothing(FIT_NOT_AN_ELLIPSOID, fit);
        return;
    }
    fit_calibration(&quadric, &ellipsoid, anchor, settled ? FIT_ELLIPSOID : FIT_NOT_CONVERGED, fit);
}
