/**
 * @file ten_elements.h
 * @brief The steps of the 10-element fit around its eigenvectors, for the calibrators that make it.
 *
 * The quadric of unit norm with the smallest algebraic error is the eigenvector of the smallest eigenvalue of the scatter matrix of
 * (xx, 2xy, 2xz, yy, 2yz, zz, x, y, z, 1), coordinates anchored and divided by a unit that makes all elements about as large as
 * the last.
 */
#ifndef HILTEST_TEN_ELEMENTS_H
#define HILTEST_TEN_ELEMENTS_H

#include "jacobi.h"
#include "normal_equations.h"

#define TEN_ELEMENTS 10

/** A fit of ten elements, from its start to its end. */
typedef struct {
    int32_t anchor[3];        /**< [counts] */
    float unit;               /**< half of the widest range [counts] */
    jacobi_t matrix;          /**< scatter matrix: the diagonal and what is above it */
    solution_t least_squares; /**< quadric of `direct`; in the end the quadric of the fit */
    ellipsoid_t ellipsoid;    /**< of that quadric */
} ten_elements_t;

/** Form the scatter matrix of coordinates divided by `unit` [counts], its diagonal in `values` and the rest in `upper`. */
void ten_elements_matrix(const moments_t *sums, float unit, jacobi_t *matrix);

/**
 * Form the scatter matrix of points, unless the prediction of closed_form.h refuses them.
 *
 * @param[out] fit_state all that `ten_elements_end` needs
 * @param[out] fit coverage and no iterations; if the points are refused, all
 * @return whether there is a matrix
 */
bool ten_elements_begin(const magnetometer_points_t *points, ten_elements_t *fit_state, magnetometer_fit_t *fit);

/**
 * Calibrate by the quadric of an eigenvector, or refuse it.
 *
 * @param vector eigenvector of the smallest eigenvalue, of any length and sign
 * @param ended whether its iteration did
 * @param[in,out] fit_state what `ten_elements_begin` stored
 * @param[out] fit all but coverage and iterations
 */
void ten_elements_end(const float vector[TEN_ELEMENTS], bool ended, ten_elements_t *fit_state, magnetometer_fit_t *fit);

/** Store the index of the smallest eigenvalue; false when it is not the only one near zero. */
bool smallest_eigenvalue(const jacobi_t *m, int size, int *index);

/** Store the quadric in counts and of unit trace; false when its trace is zero, which no ellipsoid's is. */
bool quadric_from_vector(const float v[TEN_ELEMENTS], float unit, quadric_t *quadric);

#endif
