#include "square_root.h"

#include "fast_code.h"

/* Newton's steps shrink monotonically from sqrt(3) >= p. A sphere needs one; axes 30 times apart need 7. */
#define NEWTON_LIMIT 16

/* The error left after a step is below its square, so this step leaves less than float32 resolves. */
#define NEWTON_LAST_STEP 2.0e-4f

static inline float trace_of_root(float minors, float r)
{
    float p = 1.7320508f;
    for (int step = 0; step < NEWTON_LIMIT; step++) {
        const float s = p * p - 1.0f;
        const float change = (s * s - 8.0f * r * p - 4.0f * minors) / (4.0f * (p * s - 2.0f * r));
        p -= change;
        if (!(change > NEWTON_LAST_STEP)) {
            break;
        }
    }
    return p;
}

FAST_CODE void symmetric_square_root(const symmetric_t *a, float minors, float determinant, float factor, float root[9])
{
    const float r = __builtin_sqrtf(determinant);
    const float p = trace_of_root(minors, r);
    const float q = 0.5f * (p * p - 1.0f);
    const float scale = factor / (p * q - r);
    const float first = scale * (p * p - q);
    const float identity = scale * p * r;

    const float xx = a->xx * a->xx + a->xy * a->xy + a->xz * a->xz;
    const float xy = a->xx * a->xy + a->xy * a->yy + a->xz * a->yz;
    const float xz = a->xx * a->xz + a->xy * a->yz + a->xz * a->zz;
    const float yy = a->xy * a->xy + a->yy * a->yy + a->yz * a->yz;
    const float yz = a->xy * a->xz + a->yy * a->yz + a->yz * a->zz;
    const float zz = a->xz * a->xz + a->yz * a->yz + a->zz * a->zz;

    root[0] = first * a->xx + identity - scale * xx;
    root[4] = first * a->yy + identity - scale * yy;
    root[8] = first * a->zz + identity - scale * zz;
    root[1] = root[3] = first * a->xy - scale * xy;
    root[2] = root[6] = first * a->xz - scale * xz;
    root[5] = root[7] = first * a->yz - scale * yz;
}
