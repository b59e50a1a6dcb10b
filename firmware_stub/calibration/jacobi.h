/**
 * @file jacobi.h
 * @brief Eigenvalues and eigenvectors of a small symmetric matrix by cyclic Jacobi rotations.
 *
 * Jacobi 1846, cyclic by rows as in the sensor-fusion libraries; an element below float32's rounding of the matrix is skipped.
 */
#ifndef HILTEST_JACOBI_H
#define HILTEST_JACOBI_H

#include <stdbool.h>
#include <stdint.h>

#define JACOBI_LARGEST 10

/** A symmetric matrix on the way to its diagonal form. */
typedef struct {
    float upper[JACOBI_LARGEST][JACOBI_LARGEST];   /**< elements above the diagonal; what is given of the rest is never read */
    float values[JACOBI_LARGEST];                  /**< diagonal on entry, eigenvalues on return, in no order */
    float vectors[JACOBI_LARGEST][JACOBI_LARGEST]; /**< on return, row i is the unit eigenvector of values[i] */
} jacobi_t;

/** Sweeps that are always enough: a 10x10 matrix needs 4 to 6. */
#define JACOBI_SWEEP_LIMIT 16

/**
 * Diagonalise by sweeps of rotations over all elements above the diagonal, row by row.
 *
 * An element is left alone when it is below float32's rounding of the matrix (2^-26 of the sum of |diagonal|); a sweep that
 * finds nothing to rotate ends the iteration.
 *
 * @param[in,out] matrix see jacobi_t
 * @param size rows, at most JACOBI_LARGEST
 * @param limit largest number of sweeps, at least 1
 * @return number of sweeps that rotated something; when that is the limit, more might have been needed
 */
uint16_t jacobi_diagonalise(jacobi_t *matrix, int size, uint16_t limit);

/**
 * Prepare a matrix for rotations one at a time.
 *
 * @return size below which jacobi_rotate leaves an element alone
 */
float jacobi_start(jacobi_t *matrix, int size);

/** Rotate element (i, j), i < j, to zero unless it is negligible already; returns whether it was rotated. */
bool jacobi_rotate(jacobi_t *matrix, int size, int i, int j, float negligible);

#endif
