#include "closed_form.h"

#include "adjusted_moments.h"
#include "fast_code.h"
#include "square_root.h"

#define RADIANS(degrees) ((degrees) * 0.017453293f)

/* Of n level^2. float32 resolves no smaller sum D^2; noise of 0.05 % of the field leaves as much. */
#define SMALLEST_RESIDUAL 1.0e-6f

FAST_CODE bool fit_is_accurate(const moments_t *sums, float residual, float bias_share, const solution_t *solution,
                               const ellipsoid_t *ellipsoid)
{
    const moments_t *const s = sums;
    const float *const w = solution->weakest;
    const float x = ellipsoid->centre[0], y = ellipsoid->centre[1], z = ellipsoid->centre[2];
    const float n = s->one, inverse_level = 1.0f / ellipsoid->level;
    const float least = SMALLEST_RESIDUAL * n * ellipsoid->level * ellipsoid->level;
    const float spare = n - (float)FIT_ELLIPSOID_UNKNOWNS;
    const float variance = n * (has_minus(residual - least) ? least : residual) / (spare * spare);

    const float gx = w[5] + 2.0f * x * w[0] + y * w[2] + z * w[3];
    const float gy = w[6] + 2.0f * y * w[1] + x * w[2] + z * w[4];
    const float gz = w[7] - 2.0f * z * (w[0] + w[1]) + x * w[3] + y * w[4];
    const float linear = gx * gx + gy * gy + gz * gz;
    const float shape = w[0] * w[0] + w[0] * w[1] + w[1] * w[1];
    const float crossed = w[2] * w[2] + w[3] * w[3] + w[4] * w[4];
    const float turned = 0.5f * inverse_level * linear + 0.9f * shape + 0.225f * crossed;

    const float t = 2.0f * n - (s->x * gx + s->y * gy + s->z * gz) - n * (w[5] * x + w[6] * y + w[7] * z);
    const float bias = 0.5f * bias_share * variance * inverse_level * t;
    const float *const v = solution->pivot_variance;
    const float each = 0.9f * (v[0] + v[1]) + 0.225f * (v[2] + v[3] + v[4]) + 0.5f * inverse_level * (v[5] + v[6] + v[7]);
    const float largest = RADIANS(LARGEST_DIRECTION_ERROR_DEG);
    return variance * each + turned * v[8] * (variance + bias * bias * v[8]) <= largest * largest;
}

FAST_CODE bool fit_ellipsoid(const moments_t *sums, float bias_share, solution_t *solution, ellipsoid_t *ellipsoid,
                             magnetometer_fit_t *fit)
{
    fit->coverage = quadric_fit(sums, solution);
    if (fit->coverage >= COVERAGE_SINGULAR) {
        fit_nothing(FIT_SINGULAR, fit);
        return false;
    }
    if (!quadric_ellipsoid(&solution->quadric, ellipsoid)) {
        fit_nothing(FIT_NOT_AN_ELLIPSOID, fit);
        return false;
    }
    if (!fit_is_accurate(sums, moments_residual(sums, &solution->quadric), bias_share, solution, ellipsoid)) {
        fit_nothing(FIT_POOR_COVERAGE, fit);
        return false;
    }
    return true;
}

FAST_CODE void fit_closed_form(const moments_t *sums, const int32_t anchor[3], magnetometer_fit_t *fit)
{
    solution_t solution;
    ellipsoid_t ellipsoid;

    if (fit_ellipsoid(sums, BIAS_OF_LEAST_SQUARES, &solution, &ellipsoid, fit)) {
        fit_calibration(&solution.quadric, &ellipsoid, anchor, FIT_ELLIPSOID, fit);
    }
}

FAST_CODE void fit_calibration(const quadric_t *quadric, const ellipsoid_t *ellipsoid, const int32_t anchor[3],
                               fit_status_t status, magnetometer_fit_t *fit)
{
    fit->status = status;
    fit->is_sphere = 0;
    for (int axis = 0; axis < 3; axis++) {
        fit->hard_iron[axis] = (float)anchor[axis] + ellipsoid->centre[axis];
    }
    symmetric_square_root(&quadric->shape, ellipsoid->minors, ellipsoid->determinant, 1.0f / __builtin_sqrtf(ellipsoid->level),
                          fit->soft_iron);
}
