#include "adjusted_moments.h"

#include "fast_code.h"

FAST_CODE void moments_adjust(const moments_t *sums, float variance, moments_t *adjusted)
{
    const moments_t *const s = sums;
    moments_t *const a = adjusted;
    const float v = variance, v3 = 3.0f * variance, v6 = 6.0f * variance;
    const float one = v * s->one, mixed = v * one, fourth = v3 * one;

    a->one = s->one;
    a->x = s->x;
    a->y = s->y;
    a->z = s->z;
    a->xy = s->xy;
    a->xz = s->xz;
    a->yz = s->yz;
    a->xyz = s->xyz;

    a->xx = s->xx - one;
    a->yy = s->yy - one;
    a->zz = s->zz - one;

    const float x = v * s->x, y = v * s->y, z = v * s->z;
    a->xxx = s->xxx - v3 * s->x;
    a->xxy = s->xxy - y;
    a->xxz = s->xxz - z;
    a->xyy = s->xyy - x;
    a->xzz = s->xzz - x;
    a->yyy = s->yyy - v3 * s->y;
    a->yyz = s->yyz - z;
    a->yzz = s->yzz - y;
    a->zzz = s->zzz - v3 * s->z;

    a->xxxx = s->xxxx - v6 * s->xx + fourth;
    a->yyyy = s->yyyy - v6 * s->yy + fourth;
    a->zzzz = s->zzzz - v6 * s->zz + fourth;
    a->xxyy = s->xxyy - v * (s->xx + s->yy) + mixed;
    a->xxzz = s->xxzz - v * (s->xx + s->zz) + mixed;
    a->yyzz = s->yyzz - v * (s->yy + s->zz) + mixed;
    a->xxxy = s->xxxy - v3 * s->xy;
    a->xyyy = s->xyyy - v3 * s->xy;
    a->xyzz = s->xyzz - v * s->xy;
    a->xxxz = s->xxxz - v3 * s->xz;
    a->xzzz = s->xzzz - v3 * s->xz;
    a->xyyz = s->xyyz - v * s->xz;
    a->yyyz = s->yyyz - v3 * s->yz;
    a->yzzz = s->yzzz - v3 * s->yz;
    a->xxyz = s->xxyz - v * s->yz;
}

FAST_CODE float moments_residual(const moments_t *sums, const quadric_t *quadric)
{
    const moments_t *const s = sums;
    const quadric_t *const d = quadric;
    const symmetric_t *const a = &d->shape;
    const float twice = a->xy * s->xyzz + a->xz * s->xzzz + a->yz * s->yzzz;
    return a->xx * s->xxzz + a->yy * s->yyzz + a->zz * s->zzzz + 2.0f * twice + d->linear[0] * s->xzz + d->linear[1] * s->yzz +
           d->linear[2] * s->zzz + d->constant * s->zz;
}

FAST_CODE float moments_squared_slopes(const moments_t *adjusted, const quadric_t *quadric)
{
    const moments_t *const s = adjusted;
    const quadric_t *const d = quadric;
    const symmetric_t *const a = &d->shape;
    const float gx = d->linear[0], gy = d->linear[1], gz = d->linear[2];
    const float xx = a->xx * a->xx + a->xy * a->xy + a->xz * a->xz;
    const float xy = a->xx * a->xy + a->xy * a->yy + a->xz * a->yz;
    const float xz = a->xx * a->xz + a->xy * a->yz + a->xz * a->zz;
    const float yy = a->xy * a->xy + a->yy * a->yy + a->yz * a->yz;
    const float yz = a->xy * a->xz + a->yy * a->yz + a->yz * a->zz;
    const float zz = a->xz * a->xz + a->yz * a->yz + a->zz * a->zz;
    const float second = xx * s->xx + yy * s->yy + zz * s->zz + 2.0f * (xy * s->xy + xz * s->xz + yz * s->yz);
    const float first = (a->xx * gx + a->xy * gy + a->xz * gz) * s->x + (a->xy * gx + a->yy * gy + a->yz * gz) * s->y +
                        (a->xz * gx + a->yz * gy + a->zz * gz) * s->z;
    return 4.0f * (second + first) + s->one * (gx * gx + gy * gy + gz * gz);
}

FAST_CODE float moments_noise_step(const moments_t *adjusted, const quadric_t *quadric)
{
    return moments_residual(adjusted, quadric) / moments_squared_slopes(adjusted, quadric);
}
