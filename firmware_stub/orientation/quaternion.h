/**
 * @file quaternion.h
 * @brief Products of vectors and quaternions for the filters of this folder, inlined into them.
 *
 * A quaternion is x, y, z, w; an attitude takes body components to north, east and down.
 */
#ifndef HILTEST_QUATERNION_H
#define HILTEST_QUATERNION_H

/* Up to this square of half an angle, the first terms left out of sine and cosine are below float32's half an ulp. A step of
 * half a turn is halved four times to get there. */
#define SERIES_SQUARE 0.03f

/** (pi/2)^2: half of half a turn, squared. */
#define LONGEST_HALF_SQUARE 2.4674011f

/* Squares of norms between which a vector counts as one: float32 has room for all that follows. */
#define SMALLEST_SQUARE 1.0e-12f
#define LARGEST_SQUARE 1.0e12f

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

/* Turn an attitude about the body's axes by twice a vector, whose square is at most LONGEST_HALF_SQUARE. */
INLINE void turn_attitude(float q[4], float half[3], float half_square)
{
    float turn[4];
    quaternion_of_turn(half, half_square, turn);
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
}

/* Turn an attitude about north, east and down by twice a, b and c; of first order, and of norm 1 after it. */
INLINE void correct_attitude(float q[4], float a, float b, float c)
{
    const float scale = 1.0f / __builtin_sqrtf(1.0f + a * a + b * b + c * c);
    const float x = q[0] + q[3] * a + q[2] * b - q[1] * c;
    const float y = q[1] - q[2] * a + q[3] * b + q[0] * c;
    const float z = q[2] + q[1] * a - q[0] * b + q[3] * c;
    const float w = q[3] - q[0] * a - q[1] * b - q[2] * c;
    q[0] = x * scale;
    q[1] = y * scale;
    q[2] = z * scale;
    q[3] = w * scale;
}

#endif
