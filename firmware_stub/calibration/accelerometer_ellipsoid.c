#include "accelerometer_fit.h"
#include "closed_form.h"
#include "fast_code.h"

#define HIGHEST_DEGREE 4u
#define MONOMIALS_MAXIMUM 15u

/* Monomials of one degree more: x, y and z times those given that do not begin with an earlier letter. They are in the order of
 * moments_t, so the ones without x are the last, as many as the degree has and one; and the one of z alone ends them. */
static FAST_CODE uint32_t raise_degree(const float point[3], const float *lower, uint32_t count, uint32_t degree, float *higher)
{
    uint32_t n = 0;
    for (uint32_t letter = 0; letter < 3u; letter++) {
        const uint32_t begin = letter == 0u ? 0u : letter == 1u ? count - degree - 1u : count - 1u;
        for (uint32_t k = begin; k < count; k++) {
            higher[n++] = point[letter] * lower[k];
        }
    }
    return n;
}

/* All monomials of degree 0 to 4 of one point: its own moments. */
static FAST_CODE void take_moments(const float point[3], moments_t *moments)
{
    float powers[2][MONOMIALS_MAXIMUM];
    float *moment = &moments->x;
    uint32_t count = 3;
    for (uint32_t letter = 0; letter < 3u; letter++) {
        powers[1][letter] = point[letter];
    }
    for (uint32_t degree = 1; degree <= HIGHEST_DEGREE; degree++) {
        const float *monomials = powers[degree % 2u];
        for (uint32_t k = 0; k < count; k++) {
            *moment++ = monomials[k];
        }
        if (degree < HIGHEST_DEGREE) {
            count = raise_degree(point, monomials, count, degree, powers[(degree + 1u) % 2u]);
        }
    }
    moments->one = 1.0f;
}

/* The middle of the means' range, in whole counts as the magnetometer's anchor is. */
static FAST_CODE void find_anchor(const still_poses_t *poses, int32_t anchor[3])
{
    for (uint32_t axis = 0; axis < 3u; axis++) {
        float low = poses->poses[0].accelerometer[axis];
        float high = low;
        for (uint8_t i = 1; i < poses->count; i++) {
            const float value = poses->poses[i].accelerometer[axis];
            low = value < low ? value : low;
            high = value > high ? value : high;
        }
        const float middle = 0.5f * low + 0.5f * high;
        /* No accelerometer of 16 bits reads more; what a host uploads may be anything. */
        anchor[axis] = middle > -32768.0f && middle < 32768.0f ? (int32_t)middle : 0;
    }
}

static FAST_CODE void sum_moments(const still_poses_t *poses, const int32_t anchor[3], moments_t *sums)
{
    for (uint8_t i = 0; i < poses->count; i++) {
        const float *mean = poses->poses[i].accelerometer;
        const float point[3] = {mean[0] - (float)anchor[0], mean[1] - (float)anchor[1], mean[2] - (float)anchor[2]};
        moments_t moments;
        take_moments(point, i == 0u ? sums : &moments);
        if (i > 0u) {
            moments_merge(sums, &moments);
        }
    }
}

/* Why there is no ellipsoid. Points on a plane are poor coverage at its worst. */
static FAST_CODE accelerometer_status_t status_of(fit_status_t status)
{
    return status == FIT_NOT_AN_ELLIPSOID ? ACCELEROMETER_NOT_AN_ELLIPSOID : ACCELEROMETER_POOR_COVERAGE;
}

FAST_CODE void accelerometer_ellipsoid(const still_poses_t *poses, accelerometer_fit_t *fit)
{
    int32_t anchor[3];
    moments_t sums;
    magnetometer_fit_t ellipsoid;

    if (poses->count < FIT_ELLIPSOID_UNKNOWNS) {
        accelerometer_no_fit(ACCELEROMETER_TOO_FEW_POSES, 0, NO_POSE, fit);
        return;
    }
    for (uint8_t i = 0; i < poses->count; i++) {
        if (accelerometer_moved(&poses->poses[i])) {
            accelerometer_no_fit(ACCELEROMETER_MOVED, 0, i, fit);
            return;
        }
    }
    find_anchor(poses, anchor);
    sum_moments(poses, anchor, &sums);
    fit_closed_form(&sums, anchor, &ellipsoid);
    if (ellipsoid.status != FIT_ELLIPSOID || ellipsoid.coverage > COVERAGE_LIMIT) {
        accelerometer_no_fit(status_of(ellipsoid.status), 0, NO_POSE, fit);
        return;
    }
    fit->status = ACCELEROMETER_OK;
    fit->faces = 0;
    fit->pose = NO_POSE;
    for (uint32_t i = 0; i < 9u; i++) {
        fit->calibration.gain[i] = ellipsoid.soft_iron[i];
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        fit->calibration.offset[axis] = ellipsoid.hard_iron[axis];
    }
}
