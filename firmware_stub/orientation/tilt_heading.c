#include "tilt_heading.h"

#include <math.h>

#define DEGREES_PER_RADIAN 57.29577951f

/* Sine of the angle between gravity and field below which there is no heading: 0.06 degrees, where a heading would be made of
 * noise alone at any field strength. */
#define SMALLEST_SINE 1.0e-3f

/* Divide by the largest element, so that squares neither overflow nor vanish. Returns 0 for the zero vector or one that is not
 * finite. */
static int scaled(const float in[3], float out[3])
{
    const float largest = fmaxf(fmaxf(fabsf(in[0]), fabsf(in[1])), fabsf(in[2]));
    if (!(largest > 0.0f) || !isfinite(in[0]) || !isfinite(in[1]) || !isfinite(in[2])) {
        return 0;
    }
    for (int axis = 0; axis < 3; axis++) {
        out[axis] = in[axis] / largest;
    }
    return 1;
}

tilt_status_t tilt_heading(const float gravity[3], const float field[3], float *heading_deg, float *pitch_deg,
                           float *roll_deg)
{
    float g[3], b[3];
    if (!scaled(gravity, g) || !scaled(field, b)) {
        return TILT_DEGENERATE_FIELD;
    }
    const float across = sqrtf(g[1] * g[1] + g[2] * g[2]);
    const float down = sqrtf(g[0] * g[0] + across * across);
    const float sin_roll = across > 0.0f ? g[1] / across : 0.0f;
    const float cos_roll = across > 0.0f ? g[2] / across : 1.0f;
    const float sin_pitch = -g[0] / down;
    const float cos_pitch = across / down;

    /* The field turned back by roll, then by pitch, lies in a level frame whose x axis points along the heading. */
    const float side = b[2] * sin_roll - b[1] * cos_roll;
    const float ahead = b[0] * cos_pitch + (b[1] * sin_roll + b[2] * cos_roll) * sin_pitch;
    const float total = sqrtf(b[0] * b[0] + b[1] * b[1] + b[2] * b[2]);
    if (!(sqrtf(side * side + ahead * ahead) > SMALLEST_SINE * total)) {
        return TILT_DEGENERATE_FIELD;
    }
    const float heading = atan2f(side, ahead) * DEGREES_PER_RADIAN;
    const float turned = heading < 0.0f ? heading + 360.0f : heading;
    *heading_deg = turned < 360.0f ? turned : 0.0f; /* a tiny negative angle rounds up to 360 */
    *pitch_deg = atan2f(-g[0], across) * DEGREES_PER_RADIAN;
    *roll_deg = across > 0.0f ? atan2f(g[1], g[2]) * DEGREES_PER_RADIAN : 0.0f;
    return TILT_OK;
}
