/**
 * @file magnetometer_calibrator.h
 * @brief The interface that every magnetometer calibrator implements.
 *
 * A calibrator is one function from int16 points to a soft-iron matrix and a hard-iron offset. It does no I/O, keeps nothing
 * between calls, takes bounded time, and ends in a status whatever the points are: never in NaN or infinity.
 *
 * Counts are what the sensor gives, 0.1 uT each, in the body frame (x forward, y right, z down).
 */
#ifndef HILTEST_MAGNETOMETER_CALIBRATOR_H
#define HILTEST_MAGNETOMETER_CALIBRATOR_H

#include <stdint.h>

#include "calibrator_table.h"

/** Points to fit, the range of exactly these points, kept as they were stored, and how long it may take. */
typedef struct {
    const int16_t (*points)[3]; /**< x, y, z [counts] */
    uint16_t count;
    int16_t minimum[3]; /**< smallest x, y, z among the points [counts] */
    int16_t maximum[3]; /**< largest x, y, z among the points [counts] */
    uint16_t iterations; /**< largest number of iterations, 0 for the calibrator's own; a closed form has none to limit */
} magnetometer_points_t;

/** How a fit ended. The values are part of the link protocol. */
typedef enum {
    FIT_ELLIPSOID = 0,
    FIT_NOT_AN_ELLIPSOID, /**< the best quadric is something else, or an iteration found none; no fit */
    FIT_POOR_COVERAGE,    /**< the points determine too little, or the predicted error is too large; no fit */
    FIT_TOO_FEW_POINTS,   /**< fewer than the unknowns; no fit */
    FIT_SINGULAR,         /**< points on a plane, a line or one spot; no fit */
    FIT_NOT_CONVERGED,    /**< iteration limit reached; the fit is the ellipsoid found by then */
    FIT_HORIZONTAL_FIELD, /**< of `dpi`: too little dip for a dot product with gravity; no fit */
    FIT_MIRRORED,         /**< of `dpi` and `joint`: what fits is a reflection, which no iron is; no fit */
} fit_status_t;

/** A calibration: `unit = soft_iron * (counts - hard_iron)` has norm 1 for a good point. */
typedef struct {
    fit_status_t status;
    uint8_t is_sphere;   /**< 1 when soft_iron is a multiple of the identity, from the sphere fit */
    uint16_t iterations; /**< sweeps, or whatever the calibrator repeats; 0 for a closed form */
    float soft_iron[9];  /**< row-major 3x3 [1/count]; identity when there is no fit */
    float hard_iron[3];  /**< [counts]; zero when there is no fit */
    float coverage;      /**< largest M_ii/d_i of the normal equations (1 is perfect); 0 when the calibrator has none */
} magnetometer_fit_t;

typedef void (*magnetometer_calibrator_t)(const magnetometer_points_t *points, magnetometer_fit_t *fit);

/** One calibrator, as the link knows it. */
typedef struct {
    const char *name;
    magnetometer_calibrator_t run;
} calibrator_entry_t;

extern const calibrator_entry_t calibrators[];
extern const uint8_t calibrator_count;

/** Do nothing: what a call costs, subtracted from every measured cycle count. */
void magnetometer_empty(const magnetometer_points_t *points, magnetometer_fit_t *fit);

/* Each function of the table is declared here, so that its own file needs no header. */
#define CALIBRATOR_DECLARATION(name, run) void run(const magnetometer_points_t *points, magnetometer_fit_t *fit);
CALIBRATOR_TABLE(CALIBRATOR_DECLARATION)
#undef CALIBRATOR_DECLARATION

#endif
