/**
 * @file iterative.c
 * @brief `iterative`: the 10-element fit of the public sensor-fusion libraries, over a fixed set of points.
 *
 * NXP (Freescale) Sensor Fusion library, release 5.00, the 10-element solver of its magnetic.c, which numbers no equations; written
 * from a description of the method, without its code. The quadric of unit norm with the smallest algebraic error is the eigenvector of the
 * smallest eigenvalue of the 10x10 scatter matrix; from its A, g and j to a calibration the equations are those of direct.c.
 *
 * Some things are cheaper than there: the scatter matrix is built from its 34 different sums, coordinates are anchored at the middle
 * of their range and scaled to it, which float32 likes better than the first point, the matrix square root is in closed form, and
 * rotations cost what they must (jacobi.c). DESIGN.md counts it.
 */
#include "closed_form.h"
#include "fast_code.h"
#include "jacobi.h"
#include "ten_elements.h"

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
    solution_t solution;
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
    if (!fit_ellipsoid(&sums, BIAS_OF_LEAST_SQUARES, &solution, &ellipsoid, fit)) {
        return;
    }
    ten_elements_assemble(&sums, &work);
    ten_elements_scale(unit, &work);
    const uint16_t limit = sweep_limit(points->iterations);
    fit->iterations = jacobi_diagonalise(&work, TEN_ELEMENTS, limit);
    const bool ended = fit->iterations < limit;
    if (!smallest_eigenvalue(&work, TEN_ELEMENTS, &index)) {
        fit_nothing(FIT_POOR_COVERAGE, fit);
        return;
    }
    if (!quadric_from_vector(work.vectors[index], unit, &quadric) || !quadric_ellipsoid(&quadric, &ellipsoid)) {
        fit_nothing(FIT_NOT_AN_ELLIPSOID, fit);
        return;
    }
    fit_calibration(&quadric, &ellipsoid, anchor, ended ? FIT_ELLIPSOID : FIT_NOT_CONVERGED, fit);
}
