#include "fusion.h"

#include "calibration/fast_code.h"

/* Squares of norms between which a vector counts as one: float32 has room for all that follows. */
#define SMALLEST_SQUARE 1.0e-12f
#define LARGEST_SQUARE 1.0e12f

/* Square of the sine between gravity and field below which there is no heading, as in tilt_heading.c. */
#define SMALLEST_SINE_SQUARE 1.0e-6f

/* (pi/2)^2: half of half a turn, squared. */
#define LONGEST_HALF_SQUARE 2.4674011f

/* Up to this square of half an angle, the first terms left out of sine and cosine are below float32's half an ulp. A step of
 * half a turn is halved four times to get there. */
#define SERIES_SQUARE 0.03f

#define INLINE static inline __attribute__((always_inline))

INLINE float dot3(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

INLINE void cross3(const float a[3], const float b[3], float out[3])
{
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

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

/* The quaternion of a rotation by twice a vector, equations (8) to (11): in powers of the angle, so no rotation is no case of
 * its own and there is no square root. */
INLINE void quaternion_of_turn(float half[3], float half_square, float turn[4])
{
    int halvings = 0;
    while (half_square > SERIES_SQUARE) {
        half_square *= 0.25f;
        for (int axis = 0; axis < 3; axis++) {
            half[axis] *= 0.5f;
        }
        halvings++;
    }
    const float sine = 1.0f + half_square * (half_square * (1.0f / 120.0f) - 1.0f / 6.0f); /* over the angle */
    turn[0] = sine * half[0];
    turn[1] = sine * half[1];
    turn[2] = sine * half[2];
    turn[3] = 1.0f + half_square * (half_square * (1.0f / 24.0f) - 0.5f);
    for (; halvings > 0; halvings--) {
        const float twice = 2.0f * turn[3];
        turn[3] = turn[3] * turn[3] - dot3(turn, turn);
        turn[0] *= twice;
        turn[1] *= twice;
        turn[2] *= twice;
    }
}

FAST_CODE fusion_status_t fusion_predict(fusion_t *state, const fusion_noise_t *noise, const float rate_rad_s[3], float dt_s)
{
    const float half_dt_s = 0.5f * dt_s;
    float half[3] = {half_dt_s * rate_rad_s[0], half_dt_s * rate_rad_s[1], half_dt_s * rate_rad_s[2]};
    const float half_square = dot3(half, half);
    if (!(dt_s >= 0.0f && half_square <= LONGEST_HALF_SQUARE)) {
        return FUSION_BAD_STEP; /* what is not finite compares false as well */
    }
    float turn[4];
    quaternion_of_turn(half, half_square, turn);

    float *const q = state->attitude;
    const float x = q[3] * turn[0] + q[0] * turn[3] + q[1] * turn[2] - q[2] * turn[1];
    const float y = q[3] * turn[1] - q[0] * turn[2] + q[1] * turn[3] + q[2] * turn[0];
    const float z = q[3] * turn[2] + q[0] * turn[1] - q[1] * turn[0] + q[2] * turn[3];
    const float w = q[3] * turn[3] - q[0] * turn[0] - q[1] * turn[1] - q[2] * turn[2];
    /* Only rounding takes the norm away from 1; one step of Newton's for the reciprocal root brings it back. */
    const float scale = 1.5f - 0.5f * (x * x + y * y + z * z + w * w);
    q[0] = x * scale;
    q[1] = y * scale;
    q[2] = z * scale;
    q[3] = w * scale;
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
    const float scale = 1.0f / __builtin_sqrtf(1.0f + a * a + b * b + c * c);
    const float x = q[0] + q[3] * a + q[2] * b - q[1] * c;
    const float y = q[1] - q[2] * a + q[3] * b + q[0] * c;
    const float z = q[2] + q[1] * a - q[0] * b + q[3] * c;
    const float w = q[3] - q[0] * a - q[1] * b - q[2] * c;
    q[0] = x * scale;
    q[1] = y * scale;
    q[2] = z * scale;
    q[3] = w * scale;
    return FUSION_OK;
}
