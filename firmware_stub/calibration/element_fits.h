/**
 * @file element_fits.h
 * @brief The fits of 4, 7 and 10 elements that the public sensor-fusion libraries go through as their buffer fills.
 *
 * NXP (Freescale) Sensor Fusion library, release 5.00, magnetic.c, which numbers no equations.
 *
 * 4: a sphere, by linear least squares. 7: an ellipsoid along the axes, 10: any ellipsoid, both by the eigenvector of the smallest
 * eigenvalue of the scatter matrix. The fit error is theirs: about the relative rms deviation from the surface, in percent.
 */
#ifndef HILTEST_ELEMENT_FITS_H
#define HILTEST_ELEMENT_FITS_H

#include <stdbool.h>

#include "jacobi.h"
#include "moments.h"

/** The strengths of the earth's field that the libraries accept [counts]: 10 and 90 uT. */
#define ELEMENT_FITS_WEAKEST 100.0f
#define ELEMENT_FITS_STRONGEST 900.0f

/** A calibration that may be taken over. */
typedef struct {
    float soft_iron[9]; /**< row-major 3x3 [1/count] */
    float hard_iron[3]; /**< [counts] */
    float fit_error_percent;
} trial_t;

/** Fit a sphere; false when there is none, or its field is not the earth's. */
bool element_fit_4(const moments_t *sums, const int32_t anchor[3], trial_t *trial);

/**
 * Form the scatter matrix whose eigenvectors the 7- or 10-element fit needs.
 *
 * @param sums moments about the anchor
 * @param elements 7 or 10, also the size of the matrix
 * @param[out] matrix to be diagonalised
 */
void element_fit_matrix(const moments_t *sums, uint8_t elements, jacobi_t *matrix);

/** Calibrate by the diagonalised matrix; false when it is not an ellipsoid's, or its field is not the earth's. */
bool element_fit_from_matrix(const jacobi_t *matrix, uint8_t elements, float count, const int32_t anchor[3], trial_t *trial);

#endif
