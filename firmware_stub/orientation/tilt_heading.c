#include "tilt_heading.h"

#include <math.h>
#include <stdint.h>

#define DEGREES_PER_RADIAN 57.29577951f

/* Square of the sine of the angle between gravity and field below which there is no heading: 0.06 degrees, where a heading would be
 * made of noise alone at any field strength. */
#define SMALLEST_SINE_SQUARE 1.0e-6f

/* A float, and its bits: without the sign they are in the order of magnitudes, and those of infinity and NaN the largest. */
typedef union {
    float value;
    uint32_t bits;
} float_bits_t;

#define MAGNITUDE 0x7FFFFFFFu
#define INFINITE 0x7F800000u
#define EXPONENT_SHIFT 23

static inline uint32_t magnitude(float value)
{
    const float_bits_t same = {.value = value};
    return same.bits & MAGNITUDE;
}

/* Multiply by the power of two that takes the largest element to 1 or 2, so that squares neither overflow nor vanish; that rounds
 * nothing. Returns 0 for the zero vector or one that is not finite. */
static inline int scaled(const float in[3], float out[3])
{
    const uint32_t x = magnitude(in[0]), y = magnitude(in[1]), z = magnitude(in[2]);
    const uint32_t xy = x > y ? x : y, largest = xy > z ? xy : z;
    if (largest == 0u || largest >= INFINITE) {
        return 0;
    }
    const uint32_t exponent = largest >> EXPONENT_SHIFT; /* up to 254, and 127 is that of 1 */
    const float_bits_t factor = {.bits = (exponent < 254u ? 254u - exponent : 1u) << EXPONENT_SHIFT};
    for (int axis = 0; axis < 3; axis++) {
        out[axis] = in[axis] * factor.value;
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
    const float per_across = 1.0f / across, per_down = 1.0f / down; /* straight up or down the first is infinite, and unused */
    const float sin_roll = across > 0.0f ? g[1] * per_across : 0.0f;
    const float cos_roll = across > 0.0f ? g[2] * per_across : 1.0f;
    const float sin_pitch = -g[0] * per_down;
    const float cos_pitch = across * per_down;

    /* The field turned back by roll, then by pitch, lies in a level frame whose x axis points along the heading. */
    const float side = b[2] * sin_roll - b[1] * cos_roll;
    const float ahead = b[0] * cos_pitch + (b[1] * sin_roll + b[2] * cos_roll) * sin_pitch;
    const float square = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
    if (!(side * side + ahead * ahead > SMALLEST_SINE_SQUARE * square)) {
        return TILT_DEGENERATE_FIELD;
    }
    const float heading = atan2f(side, ahead) * DEGREES_PER_RADIAN;
    const float turned = heading < 0.0f ? heading + 360.0f : heading;
    *heading_deg = turned < 360.0f ? turned : 0.0f; /* a tiny negative angle rounds up to 360 */
    *pitch_deg = atan2f(-g[0], across) * DEGREES_PER_RADIAN;
    *roll_deg = across > 0.0f ? atan2f(g[1], g[2]) * DEGREES_PER_RADIAN : 0.0f;
    return TILT_OK;
}
