#include "attitude_filter.h"

#include "calibration/fast_code.h"
#include "quaternion.h"
#include "triad.h"

/* Longest time that one correction stands for; after a gap the sensors show one moment of it. */
#define LONGEST_CORRECTION_S 1.0f

#define SQUARE_ROOT_OF_2 1.41421356f
#define TILT_FREQUENCY (SQUARE_ROOT_OF_2 / ATTITUDE_FILTER_TILT_TIME_S)

/* North, east and down in the body frame. */
INLINE void axes_of_attitude(const float q[4], float north[3], float east[3], float down[3])
{
    const float x = q[0], y = q[1], z = q[2], w = q[3];
    const float x2 = x + x, y2 = y + y, z2 = z + z;
    const float xx = x * x2, yy = y * y2, zz = z * z2;
    const float xy = x * y2, xz = x * z2, yz = y * z2;
    const float wx = w * x2, wy = w * y2, wz = w * z2;
    north[0] = 1.0f - yy - zz;
    north[1] = xy - wz;
    north[2] = xz + wy;
    east[0] = xy + wz;
    east[1] = 1.0f - xx - zz;
    east[2] = yz - wx;
    down[0] = xz - wy;
    down[1] = yz + wx;
    down[2] = 1.0f - xx - yy;
}

INLINE float smaller(float a, float b)
{
    return a < b ? a : b;
}

void attitude_filter_init(attitude_filter_t *state, const float bias_rad_s[3])
{
    *state = (attitude_filter_t){
        .attitude = {0.0f, 0.0f, 0.0f, 1.0f},
        .bias_rad_s = {bias_rad_s[0], bias_rad_s[1], bias_rad_s[2]},
    };
}

void attitude_filter_attitude(const attitude_filter_t *state, float attitude[4])
{
    for (int i = 0; i < 4; i++) {
        attitude[i] = state->attitude[i];
    }
}

FAST_CODE attitude_filter_status_t attitude_filter_turn(attitude_filter_t *state, const float rate_rad_s[3], float dt_s)
{
    const float half_dt_s = 0.5f * dt_s;
    float half[3];
    for (int axis = 0; axis < 3; axis++) {
        half[axis] = half_dt_s * (rate_rad_s[axis] - state->bias_rad_s[axis]);
    }
    const float half_square = dot3(half, half);
    if (!(dt_s >= 0.0f && half_square <= LONGEST_HALF_SQUARE)) {
        return ATTITUDE_FILTER_BAD_STEP; /* what is not finite compares false as well */
    }
    turn_attitude(state->attitude, half, half_square);
    state->uncorrected_s += dt_s;
    return ATTITUDE_FILTER_OK;
}

/* Take the first attitude and the first expected field from one measurement. */
FAST_CODE __attribute__((noinline)) static attitude_filter_status_t start(attitude_filter_t *state, const float gravity_g[3],
                                                                          const float field[3])
{
    if (!triad(gravity_g, field, state->attitude)) {
        return ATTITUDE_FILTER_NO_ATTITUDE;
    }
    float north[3], east[3], down[3];
    axes_of_attitude(state->attitude, north, east, down);
    const float to_north = dot3(north, field), to_east = dot3(east, field);
    state->field[0] = __builtin_sqrtf(to_north * to_north + to_east * to_east);
    state->field[1] = dot3(down, field);
    state->age_s = smaller(state->uncorrected_s, LONGEST_CORRECTION_S);
    state->uncorrected_s = 0.0f;
    state->started = true;
    return ATTITUDE_FILTER_OK;
}

/* Rotations about north and east for a gravity with these horizontal components. */
INLINE void tilt_correction(attitude_filter_t *state, float north_g, float east_g, float dt_s, float per_time,
                            float rotation[2])
{
    if (per_time > 1.0f / ATTITUDE_FILTER_TILT_TIME_S) {
        rotation[0] = dt_s * per_time * east_g;
        rotation[1] = -(dt_s * per_time * north_g);
        return;
    }
    const float gain = dt_s * (TILT_FREQUENCY * TILT_FREQUENCY);
    const float loss = dt_s * (SQUARE_ROOT_OF_2 * TILT_FREQUENCY);
    state->tilt_rate[0] += gain * east_g - loss * state->tilt_rate[0];
    state->tilt_rate[1] -= gain * north_g + loss * state->tilt_rate[1];
    rotation[0] = dt_s * state->tilt_rate[0];
    rotation[1] = dt_s * state->tilt_rate[1];
}

/* Follow the field with the expected one; return whether the field is near enough to it to tell the heading. While the
 * tilt is young, the parts of the field are not known well enough for a gate. */
INLINE bool field_is_expected(attitude_filter_t *state, float horizontal, float down, float gain, float per_time)
{
    const float more_horizontal = horizontal - state->field[0], more_down = down - state->field[1];
    const float distance_square = more_horizontal * more_horizontal + more_down * more_down;
    const float gate_square = ATTITUDE_FILTER_FIELD_GATE * ATTITUDE_FILTER_FIELD_GATE *
                              (state->field[0] * state->field[0] + state->field[1] * state->field[1]);
    const bool expected = distance_square <= gate_square || per_time > 1.0f / ATTITUDE_FILTER_TILT_TIME_S;
    if (!expected) {
        gain *= __builtin_sqrtf(gate_square / distance_square); /* counts as one at the gate */
    }
    state->field[0] += gain * more_horizontal;
    state->field[1] += gain * more_down;
    return expected;
}

FAST_CODE attitude_filter_status_t attitude_filter_correct(attitude_filter_t *state, const float gravity_g[3],
                                                           const float field[3])
{
    if (!(dot3(gravity_g, gravity_g) < LARGEST_SQUARE)) {
        return ATTITUDE_FILTER_NO_ATTITUDE;
    }
    if (!state->started) {
        return start(state, gravity_g, field);
    }
    const float dt_s = smaller(state->uncorrected_s, LONGEST_CORRECTION_S);
    state->uncorrected_s = 0.0f;
    if (dt_s == 0.0f) {
        return ATTITUDE_FILTER_OK;
    }
    state->age_s += dt_s;
    const float per_time = 2.0f / (state->age_s + dt_s);
    float north[3], east[3], down[3];
    axes_of_attitude(state->attitude, north, east, down);
    float rotation[2];
    tilt_correction(state, dot3(north, gravity_g), dot3(east, gravity_g), dt_s, per_time, rotation);

    const float to_north = dot3(north, field), to_east = dot3(east, field), to_down = dot3(down, field);
    const float horizontal_square = to_north * to_north + to_east * to_east;
    const float field_square = horizontal_square + to_down * to_down;
    float about_down = 0.0f;
    attitude_filter_status_t status = ATTITUDE_FILTER_FIELD_LEFT_OUT;
    if (field_square > SMALLEST_SQUARE && field_square < LARGEST_SQUARE) {
        const float horizontal = __builtin_sqrtf(horizontal_square);
        const bool young = per_time > 1.0f / ATTITUDE_FILTER_HEADING_TIME_S;
        const float gain = dt_s * (young ? per_time : 1.0f / ATTITUDE_FILTER_FIELD_TIME_S);
        if (field_is_expected(state, horizontal, to_down, gain, per_time) && horizontal_square > SMALLEST_SQUARE) {
            const float sine = to_north > 0.0f ? to_east / horizontal : __builtin_copysignf(1.0f, to_east);
            about_down = -(sine * dt_s * (young ? per_time : 1.0f / ATTITUDE_FILTER_HEADING_TIME_S));
            status = ATTITUDE_FILTER_OK;
        }
    }
    correct_attitude(state->attitude, 0.5f * rotation[0], 0.5f * rotation[1], 0.5f * about_down);
    return status;
}

FAST_CODE attitude_filter_status_t attitude_filter_update(attitude_filter_t *state, const float rate_rad_s[3],
                                                          const float gravity_g[3], const float field[3], float dt_s)
{
    const attitude_filter_status_t status = attitude_filter_turn(state, rate_rad_s, dt_s);
    return status == ATTITUDE_FILTER_OK ? attitude_filter_correct(state, gravity_g, field) : status;
}
