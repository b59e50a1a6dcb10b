/**
 * @file gyroscope_turns.h
 * @brief Scale and axes of a gyroscope from whole turns about known axes, by linear least squares.
 *
 * A board that turns about an axis which does not move, and comes back to rest, has turned by the integral of its rate: `turned`, a
 * vector along the axis, in the body frame the same all the way. The gyroscope gives `counts = response * rate + bias`, so the
 * integral of its counts without bias is `response * turned`: linear in the nine unknowns, whatever the course of the rate.
 * Turns t and integrals s give `response = (sum s t') (sum t t')^-1`, exactly solved by three turns that span, and the calibration
 * is its inverse: `rate_dps = matrix * (counts - bias)`. The bias drifts with temperature; it is taken from the rests
 * before and after each turn, interpolated to the middle of the turn.
 *
 * Model: Puc, Podobnik, Munih 2018 (ERK), eq. 3 and 6, which leave the matrix at a constant for want of a reference; the
 * turntable is one.
 */
#ifndef HILTEST_GYROSCOPE_TURNS_H
#define HILTEST_GYROSCOPE_TURNS_H

#include <stdint.h>

/** Most turns of one fit. */
#define GYROSCOPE_TURNS_MAXIMUM 8u

/** One turn: what the table did, and what the gyroscope gave from before it until after it. */
typedef struct {
    float turned_deg[3];  /**< about the body axes, all of it about one axis that did not move */
    int32_t sum[3];       /**< of all samples [counts] */
    uint16_t count;       /**< samples, at least 2 */
    uint32_t duration_us; /**< from the first sample to the last */
    float bias_before[3]; /**< mean of the rest before [counts] */
    float bias_after[3];  /**< and of the one after */
    float share;          /**< of the way from the middle of the one rest to that of the other, where the turn's middle lies */
} gyroscope_turn_t;

typedef struct {
    const gyroscope_turn_t *turns;
    uint8_t count; /**< at most GYROSCOPE_TURNS_MAXIMUM */
} gyroscope_turns_t;

typedef enum {
    GYROSCOPE_TURNS_OK = 0,
    GYROSCOPE_TURNS_TOO_FEW = 1,     /**< fewer than three */
    GYROSCOPE_TURNS_TOO_SMALL = 2,   /**< one is below 90 degrees, or has no samples; `at_fault` says which */
    GYROSCOPE_TURNS_NOT_SPANNING = 3, /**< all axes lie in or near one plane */
    GYROSCOPE_TURNS_SINGULAR = 4,    /**< the gyroscope did not see the turns: one of its axes is dead */
} gyroscope_turns_status_t;

typedef struct {
    gyroscope_turns_status_t status;
    uint8_t at_fault;      /**< index of a turn, GYROSCOPE_TURNS_MAXIMUM when none is named */
    float matrix[9];       /**< row-major [deg/s/count]; 0 unless GYROSCOPE_TURNS_OK */
    float residual_deg;    /**< rms of `matrix * integral - turned` over all turns; 0 for three, which are met exactly */
} gyroscope_turns_fit_t;

/** The integral of the gyroscope over a turn, without bias [count s]; all zero when there are no samples or no time. */
void gyroscope_turn_integral(const gyroscope_turn_t *turn, float integral[3]);

/** Fit the matrix. Bounded: one pass over the turns and two inverses in closed form. */
void gyroscope_turns_fit(const gyroscope_turns_t *turns, gyroscope_turns_fit_t *fit);

#endif
