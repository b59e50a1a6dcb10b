/**
 * @file fit_result.h
 * @brief The result without a calibration, and the sphere fit, from which other fits start.
 */
#ifndef HILTEST_FIT_RESULT_H
#define HILTEST_FIT_RESULT_H

#include <stdbool.h>

#include "moments.h"

/** A sphere has 4 unknowns, an ellipsoid 9. */
#define FIT_SPHERE_UNKNOWNS 4
#define FIT_ELLIPSOID_UNKNOWNS 9

/** The sphere that least squares finds. */
typedef struct {
    float centre[3];  /**< relative to the anchor [counts] */
    float square;     /**< of the radius [counts^2] */
    float explained;  /**< what it explains of the sum of the fourth powers of the points' distances from the anchor [counts^4] */
} sphere_t;

/** Fit a sphere to moments about an anchor; false when the points lie on a plane or leave no radius. */
bool sphere_from_moments(const moments_t *sums, sphere_t *sphere);

/** Store a status without a fit: soft_iron is the identity, hard_iron zero. */
void fit_nothing(fit_status_t status, magnetometer_fit_t *fit);

#endif
