/**
 * @file quadric.h
 * @brief A quadric surface, and the ellipsoid it may be.
 *
 * Mucciaccia 2020, eq. 49 and 50; centre and level stand for its eq. 57 to 62, which are wrong as printed (direct.c).
 */
#ifndef HILTEST_QUADRIC_H
#define HILTEST_QUADRIC_H

#include <stdbool.h>
#include <stdint.h>

/** Symmetric 3x3 matrix. */
typedef struct {
    float xx, xy, xz, yy, yz, zz;
} symmetric_t;

/** All p with `p' shape p + linear . p + constant = 0`; the trace of shape is 1. Coordinates are relative to the anchor. */
typedef struct {
    symmetric_t shape;
    float linear[3]; /**< [counts] */
    float constant;  /**< [counts^2] */
} quadric_t;

/** All p with `(p - centre)' shape (p - centre) = level`. */
typedef struct {
    float centre[3];   /**< relative to the anchor [counts] */
    float level;       /**< [counts^2] */
    float minors;      /**< sum of the three principal 2x2 minors of shape */
    float determinant; /**< of shape */
} ellipsoid_t;

/**
 * Find centre and level of a quadric, if it is an ellipsoid.
 *
 * A determinant below 1e-6 counts as none: float32 cannot tell an ellipsoid with axes more than some hundred times apart from
 * a paraboloid or a hyperboloid.
 *
 * @param quadric surface with unit trace
 * @param[out] ellipsoid its centre and level; untouched when it is none
 * @return true when shape is positive definite and level positive
 */
bool quadric_ellipsoid(const quadric_t *quadric, ellipsoid_t *ellipsoid);

#endif
