#include "triad.h"

#include "calibration/fast_code.h"
#include "quaternion.h"

/* Square of the sine between gravity and field below which there is no heading, as in tilt_heading.c. */
#define SMALLEST_SINE_SQUARE 1.0e-6f

/* North, east and down in the body frame; false if there are none. */
INLINE bool earth_axes(const float gravity[3], const float field[3], float north[3], float east[3], float down[3])
{
    const float gravity_square = dot3(gravity, gravity);
    const float field_square = dot3(field, field);
    if (!(gravity_square > SMALLEST_SQUARE && gravity_square < LARGEST_SQUARE && field_square > SMALLEST_SQUARE &&
          field_square < LARGEST_SQUARE)) {
        return false;
    }
    cross3(gravity, field, east);
    const float east_square = dot3(east, east);
    if (!(east_square > SMALLEST_SINE_SQUARE * gravity_square * field_square)) {
        return false;
    }
    const float gravity_norm = __builtin_sqrtf(gravity_square);
    const float east_norm = __builtin_sqrtf(east_square);
    const float reciprocal = 1.0f / (gravity_norm * east_norm); /* one division is enough for both */
    for (int axis = 0; axis < 3; axis++) {
        down[axis] = gravity[axis] * (reciprocal * east_norm);
        east[axis] = east[axis] * (reciprocal * gravity_norm);
    }
    cross3(east, down, north);
    return true;
}

FAST_CODE bool triad(const float gravity[3], const float field[3], float attitude[4])
{
    float north[3], east[3], down[3];
    if (!earth_axes(gravity, field, north, east, down)) {
        return false;
    }
    /* Four times the outer square of the quaternion, in the row of its largest diagonal element: its norm is twice the root of
     * that element. */
    float row[4], diagonal;
    if (down[2] >= 0.0f) {
        if (north[0] + east[1] >= 0.0f) {
            row[3] = diagonal = 1.0f + north[0] + east[1] + down[2];
            row[0] = down[1] - east[2];
            row[1] = north[2] - down[0];
            row[2] = east[0] - north[1];
        } else {
            row[2] = diagonal = 1.0f - north[0] - east[1] + down[2];
            row[0] = north[2] + down[0];
            row[1] = east[2] + down[1];
            row[3] = east[0] - north[1];
        }
    } else if (north[0] >= east[1]) {
        row[0] = diagonal = 1.0f + north[0] - east[1] - down[2];
        row[1] = north[1] + east[0];
        row[2] = north[2] + down[0];
        row[3] = down[1] - east[2];
    } else {
        row[1] = diagonal = 1.0f - north[0] + east[1] - down[2];
        row[0] = north[1] + east[0];
        row[2] = east[2] + down[1];
        row[3] = north[2] - down[0];
    }
    const float scale = 0.5f / __builtin_sqrtf(diagonal);
    for (int i = 0; i < 4; i++) {
        attitude[i] = scale * row[i];
    }
    return true;
}
