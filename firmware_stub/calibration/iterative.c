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
#include "fast_code.h"
#include "fit_result.h"
#include "jacobi.h"
#include "ten_elements.h"

/* Sweeps allowed: those asked for, within the solver's own limit. */
static inline uint16_t sweep_limit(uint16_t asked)
{
    return asked == 0u || asked > JACOBI_SWEEP_LIMIT ? JACOBI_SWEEP_LIMIT : asked;
}

FAST_CODE void magnetometer_iterative(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    ten_elements_t ten;
    int index;

    if (!ten_elements_begin(points, &ten, fit)) {
        return;
    }
    const uint16_t limit = sweep_limit(points->iterations);
    fit->iterations = jacobi_diagonalise(&ten.matrix, TEN_ELEMENTS, limit);
    if (!smallest_eigenvalue(&ten.matrix, TEN_ELEMENTS, &index)) {
        fit_nothing(FIT_POOR_COVERAGE, fit);
        return;
    }
    ten_elements_end(ten.matrix.vectors[index], fit->iterations < limit, &ten, fit);
}
