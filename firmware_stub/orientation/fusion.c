#include "fusion.h"

#include "calibration/fast_code.h"
#include "quaternion.h"

/* Squares of norms between which a vector counts as one: float32 has room for all that follows. */
#define SMALLEST_SQUARE 1.0e-12f
#define LARGEST_SQUARE 1.0e12f

/* Square of the sine between gravity and field below which there is no heading, as in tilt_heading.c. */
#define SMALLEST_SINE_SQUARE 1.0e-6f

/* North, east and down as the body sees them. */
INLINE fusion_status_t earth_axes(const float gravity_g[3], const float field[3], float gate_g, float north[3], float east[3],
                                  float down[3])
{
    const float gravity_square = dot3(gravity_g, gravity_g);
    const float field_square = dot3(field, field);
    if (!(gravity_square > SMALLEST_SQUARE && gravity_square < LARGEST_SQUARE && field_square > SMALLEST_SQUARE &&
          field_square < LARGEST_SQUARE)) {
        return FUSION_NO_ATTITUDE;
    }
    cross3(gravity_g, field, east);
    const float east_square = dot3(east, east);
    if (!(east_square > SMALLEST_SINE_SQUARE * gravity_square * field_square)) {
        return FUSION_NO_ATTITUDE;
    }
    const float gravity_norm = __builtin_sqrtf(gravity_square);
    const float east_norm = __builtin_sqrtf(east_square);
    if (!(__builtin_fabsf(gravity_norm - 1.0f) <= gate_g)) {
        return FUSION_ACCELERATED;
    }
    const float reciprocal = 1.0f / (gravity_norm * east_norm); /* one division is enough for both */
    for (int axis = 0; axis < 3; axis++) {
        down[axis] = gravity_g[axis] * (reciprocal * east_norm);
        east[axis] = east[axis] * (reciprocal * gravity_norm);
    }
    cross3(east, down, north);
    return FUSION_OK;
}

/* Four times the outer square of the quaternion, in the row of its largest diagonal element, which is returned. The row has a
 * norm of twice that element's root; it is not divided by it here, since what follows divides anyway. */
INLINE float row_of_axes(const float north[3], const float east[3], const float down[3], float q[4])
{
    float diagonal;
    if (down[2] >= 0.0f) {
        if (north[0] + east[1] >= 0.0f) {
            q[3] = diagonal = 1.0f + north[0] + east[1] + down[2];
            q[0] = down[1] - east[2];
            q[1] = north[2] - down[0];
            q[2] = east[0] - north[1];
        } else {
            q[2] = diagonal = 1.0f - north[0] - east[1] + down[2];
            q[0] = north[2] + down[0];
            q[1] = east[2] + down[1];
            q[3] = east[0] - north[1];
        }
    } else if (north[0] >= east[1]) {
        q[0] = diagonal = 1.0f + north[0] - east[1] - down[2];
        q[1] = north[1] + east[0];
        q[2] = north[2] + down[0];
        q[3] = down[1] - east[2];
    } else {
        q[1] = diagonal = 1.0f - north[0] + east[1] - down[2];
        q[0] = north[1] + east[0];
        q[2] = east[2] + down[1];
        q[3] = north[2] - down[0];
    }
    return diagonal;
}

FAST_CODE fusion_status_t fusion_triad(const float gravity_g[3], const float field[3], float gate_g, float attitude[4])
{
    float north[3], east[3], down[3];
    const fusion_status_t status = earth_axes(gravity_g, field, gate_g, north, east, down);
    if (status == FUSION_OK) {
        float row[4];
        const float scale = 0.5f / __builtin_sqrtf(row_of_axes(north, east, down, row));
        for (int i = 0; i < 4; i++) {
            attitude[i] = scale * row[i];
        }
    }
    return status;
}

void fusion_start(fusion_t *state, const fusion_noise_t *noise, const float attitude[4])
{
    for (int i = 0; i < 4; i++) {
        state->attitude[i] = attitude[i];
    }
    state->tilt_variance = noise->tilt_variance;
    state->heading_variance = noise->heading_variance;
}

FAST_CODE fusion_status_t fusion_predict(fusion_t *state, const fusion_noise_t *noise, const float rate_rad_s[3], float dt_s)
{
    const float half_dt_s = 0.5f * dt_s;
    float half[3] = {half_dt_s * rate_rad_s[0], half_dt_s * rate_rad_s[1], half_dt_s * rate_rad_s[2]};
    const float half_square = dot3(half, half);
    if (!(dt_s >= 0.0f && half_square <= LONGEST_HALF_SQUARE)) {
        return FUSION_BAD_STEP; /* what is not finite compares false as well */
    }
    turn_attitude(state->attitude, half, half_square);
    const float spread = noise->rate_variance * dt_s;
    state->tilt_variance += spread;
    state->heading_variance += spread;
    return FUSION_OK;
}

FAST_CODE fusion_status_t fusion_update(fusion_t *state, const fusion_noise_t *noise, const float gravity_g[3],
                                        const float field[3])
{
    float north[3], east[3], down[3];
    const fusion_status_t status = earth_axes(gravity_g, field, noise->gate_g, north, east, down);
    if (status != FUSION_OK) {
        return status;
    }
    float row[4]; /* the measured attitude, times 2 root */
    const float root = __builtin_sqrtf(row_of_axes(north, east, down, row));
    float *const q = state->attitude;
    /* Along the predicted attitude, and along its turns about north, east and down. */
    const float along = q[0] * row[0] + q[1] * row[1] + q[2] * row[2] + q[3] * row[3];
    const float about_north = q[3] * row[0] - q[2] * row[1] + q[1] * row[2] - q[0] * row[3];
    const float about_east = q[2] * row[0] + q[3] * row[1] - q[0] * row[2] - q[1] * row[3];
    const float about_down = q[0] * row[1] - q[1] * row[0] + q[3] * row[2] - q[2] * row[3];

    /* One division for both gains and for the row. */
    const float tilt_sum = state->tilt_variance + noise->tilt_variance;
    const float heading_sum = state->heading_variance + noise->heading_variance;
    const float reciprocal = 1.0f / (tilt_sum * heading_sum * root);
    const float tilt = state->tilt_variance * heading_sum * reciprocal;
    const float heading = state->heading_variance * tilt_sum * reciprocal;
    state->tilt_variance -= root * tilt * state->tilt_variance;
    state->heading_variance -= root * heading * state->heading_variance;

    const float half = has_minus(along) ? -0.5f : 0.5f; /* of the two signs of an attitude, the nearer */
    const float a = half * tilt * about_north;
    const float b = half * tilt * about_east;
    const float c = half * heading * about_down;
    correct_attitude(q, a, b, c);
    return FUSION_OK;
}
