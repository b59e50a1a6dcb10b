/**
 * @file corrected.c
 * @brief `corrected`: the fit of `direct` without the bias that noise makes, by Newton steps on the variance of the noise.
 *
 * Adjusted least squares: Kukush, Markovsky and Van Huffel, Consistent estimation in an implicit quadratic measurement error model,
 * Computational Statistics & Data Analysis 47, 2004. Each step is the fit of direct.c (Mucciaccia 2020, eq. 36 to 65, corrected) to
 * moments that noise of this variance is taken out of; adjusted_moments.h has the equations. The quadric has unit trace here, not the
 * paper's unit norm, and the root is found by Newton's method. The sums are those of `direct-fast`: packed_moments.h. Where that cannot
 * be better than the fit of `direct`, it is that fit.
 */
#include "adjusted_moments.h"
#include "closed_form.h"
#include "fast_code.h"
#include "packed_moments.h"

/* Simulated at 2.5 uT and 1000 points: median error 1.03 degrees without a step, 0.496 after one, 0.489 after two and any more. */
#define NEWTON_STEPS 2

/* With fewer points the fit's variance outweighs the bias that it is rid of. */
#define FEWEST_POINTS 50

/* From this noise on the moments without it are so much smaller that the error is predicted again from them. The noise is that of a
 * calibrated reading, rms of an axis: sqrt(s trace(C C') / 3), where C = sqrt(A / level) and A has trace 1. */
#define LARGE_NOISE 0.1f
#define LARGE_VARIANCE (3.0f * LARGE_NOISE * LARGE_NOISE) /* of level */

/* A variance that leaves no ellipsoid is too large. The 6 % that all shrinks together leave of it would correct nothing. */
#define SHRINK 0.7f
#define SHRINKS 8

/** A fit to moments that noise of some variance is taken out of. */
typedef struct {
    float variance; /**< [counts^2] */
    moments_t sums;
    solution_t solution;
    ellipsoid_t ellipsoid;
} adjusted_t;

/* Fit at the variance of `fit`, or at the largest shrunk one that leaves an ellipsoid. */
static FAST_CODE bool largest_ellipsoid(const moments_t *sums, adjusted_t *fit)
{
    for (int shrinks = 0; shrinks <= SHRINKS; shrinks++) {
        moments_adjust(sums, fit->variance, &fit->sums);
        if (quadric_fit(&fit->sums, &fit->solution) < COVERAGE_SINGULAR &&
            quadric_ellipsoid(&fit->solution.quadric, &fit->ellipsoid)) {
            return true;
        }
        fit->variance *= SHRINK;
    }
    return false;
}

/* Noise of variance s adds s [sum |grad D|^2] to a sum D^2 that is zero without it. */
static FAST_CODE bool is_accurate(const adjusted_t *fit)
{
    if (fit->variance < LARGE_VARIANCE * fit->ellipsoid.level) {
        return true; /* the prediction of `direct` holds */
    }
    const float residual = fit->variance * moments_squared_slopes(&fit->sums, &fit->solution.quadric);
    return fit_is_accurate(&fit->sums, residual, BIAS_LEFT, &fit->solution, &fit->ellipsoid);
}

/* Take Newton steps, at least one, from the fit of `direct`, whose quadric is in `fit`; false when what they lead to is not to be used. */
static FAST_CODE bool newton(const moments_t *sums, uint16_t steps, adjusted_t *fit)
{
    fit->variance = 0.0f;
    for (uint16_t step = 0; step < steps; step++) {
        const float variance = fit->variance + moments_noise_step(step == 0u ? sums : &fit->sums, &fit->solution.quadric);
        fit->variance = variance > 0.0f ? variance : 0.0f;
        if (!largest_ellipsoid(sums, fit)) {
            return false;
        }
    }
    return is_accurate(fit);
}

FAST_CODE void magnetometer_corrected(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    int32_t anchor[3];
    moments_t sums;
    adjusted_t adjusted;

    if (points->count < FEWEST_POINTS) {
        magnetometer_direct(points, fit);
        return;
    }
    moments_anchor(points, anchor);
    packed_moments_sum(points, anchor, &sums);
    const uint16_t steps = points->iterations == 0u || points->iterations > NEWTON_STEPS ? NEWTON_STEPS : points->iterations;
    if (!fit_ellipsoid(&sums, BIAS_LEFT, &adjusted.solution, &adjusted.ellipsoid, fit) || fit->coverage > COVERAGE_LIMIT ||
        !newton(&sums, steps, &adjusted)) {
        magnetometer_direct(points, fit); /* of exact sums */
        return;
    }
    fit->iterations = steps;
    fit_calibration(&adjusted.solution.quadric, &adjusted.ellipsoid, anchor, steps < NEWTON_STEPS ? FIT_NOT_CONVERGED : FIT_ELLIPSOID, fit);
}
