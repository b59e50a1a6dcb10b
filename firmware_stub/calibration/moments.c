#include "moments.h"

#include <stddef.h>

#include "fast_code.h"

/* One pass cannot hold 34 sums in 32 registers, and sums in memory cost a load and a store each. Two passes keep them in
 * registers: the 20 monomials with a factor x, then the 14 without. That split converts only y and z twice and repeats two
 * products; a split by degree would convert all three and repeat six. */

#define INLINE static inline __attribute__((always_inline))

/* Squares are summed as whole numbers, in the cycle that a float's sum takes (SMLAL). In float32 they would be biased: a square
 * is 0 or 1 modulo 4, so above 2^24, where floats are even, adding an odd one is a tie, which goes to the multiple of 4 below, each
 * time. At 300 points that alone was nine tenths of the heading error that float32 makes. */
INLINE float rounded(int64_t sum)
{
    return (float)(uint32_t)(sum >> 32) * 4294967296.0f + (float)(uint32_t)sum;
}

FAST_CODE void moments_anchor(const magnetometer_points_t *points, int32_t anchor[3])
{
    anchor[0] = (points->minimum[0] + points->maximum[0]) / 2;
    anchor[1] = (points->minimum[1] + points->maximum[1]) / 2;
    anchor[2] = (points->minimum[2] + points->maximum[2]) / 2;
}

static FAST_CODE void sum_with_x(const magnetometer_points_t *points, const int32_t anchor[3], moments_t *sums)
{
    const int32_t ax = anchor[0], ay = anchor[1], az = anchor[2];
    const int16_t (*point)[3] = points->points;
    int64_t s_xx = 0;
    float s_x = 0.0f, s_xy = 0.0f, s_xz = 0.0f, s_xxx = 0.0f, s_xxy = 0.0f, s_xxz = 0.0f, s_xyy = 0.0f;
    float s_xyz = 0.0f, s_xzz = 0.0f, s_xxxx = 0.0f, s_xxxy = 0.0f, s_xxxz = 0.0f, s_xxyy = 0.0f, s_xxyz = 0.0f;
    float s_xxzz = 0.0f, s_xyyy = 0.0f, s_xyyz = 0.0f, s_xyzz = 0.0f, s_xzzz = 0.0f;

#pragma GCC unroll 4
    for (uint32_t left = points->count; left > 0u; left--, point++) {
        const int32_t dx = (*point)[0] - ax;
        const float x = (float)dx, y = (float)((*point)[1] - ay), z = (float)((*point)[2] - az);
        const float xx = x * x, xy = x * y, xz = x * z, yy = y * y, zz = z * z;
        s_x += x;
        s_xx += (int64_t)dx * dx;
        s_xy += xy;
        s_xz += xz;
        s_xxx += xx * x;
        s_xxy += xx * y;
        s_xxz += xx * z;
        s_xyy += xy * y;
        s_xyz += xy * z;
        s_xzz += xz * z;
        s_xxxx += xx * xx;
        s_xxxy += xx * xy;
        s_xxxz += xx * xz;
        s_xxyy += xy * xy;
        s_xxyz += xy * xz;
        s_xxzz += xz * xz;
        s_xyyy += xy * yy;
        s_xyyz += xz * yy;
        s_xyzz += xy * zz;
        s_xzzz += xz * zz;
    }
    sums->x = s_x;
    sums->xx = rounded(s_xx);
    sums->xy = s_xy;
    sums->xz = s_xz;
    sums->xxx = s_xxx;
    sums->xxy = s_xxy;
    sums->xxz = s_xxz;
    sums->xyy = s_xyy;
    sums->xyz = s_xyz;
    sums->xzz = s_xzz;
    sums->xxxx = s_xxxx;
    sums->xxxy = s_xxxy;
    sums->xxxz = s_xxxz;
    sums->xxyy = s_xxyy;
    sums->xxyz = s_xxyz;
    sums->xxzz = s_xxzz;
    sums->xyyy = s_xyyy;
    sums->xyyz = s_xyyz;
    sums->xyzz = s_xyzz;
    sums->xzzz = s_xzzz;
}

static FAST_CODE void sum_without_x(const magnetometer_points_t *points, const int32_t anchor[3], moments_t *sums)
{
    const int32_t ay = anchor[1], az = anchor[2];
    const int16_t (*point)[3] = points->points;
    int64_t s_yy = 0, s_zz = 0;
    float s_y = 0.0f, s_z = 0.0f, s_yz = 0.0f, s_yyy = 0.0f, s_yyz = 0.0f, s_yzz = 0.0f;
    float s_zzz = 0.0f, s_yyyy = 0.0f, s_yyyz = 0.0f, s_yyzz = 0.0f, s_yzzz = 0.0f, s_zzzz = 0.0f;

#pragma GCC unroll 4
    for (uint32_t left = points->count; left > 0u; left--, point++) {
        const int32_t dy = (*point)[1] - ay, dz = (*point)[2] - az;
        const float y = (float)dy, z = (float)dz;
        const float yy = y * y, yz = y * z, zz = z * z;
        s_y += y;
        s_z += z;
        s_yy += (int64_t)dy * dy;
        s_yz += yz;
        s_zz += (int64_t)dz * dz;
        s_yyy += yy * y;
        s_yyz += yy * z;
        s_yzz += zz * y;
        s_zzz += zz * z;
        s_yyyy += yy * yy;
        s_yyyz += yy * yz;
        s_yyzz += yz * yz;
        s_yzzz += yz * zz;
        s_zzzz += zz * zz;
    }
    sums->y = s_y;
    sums->z = s_z;
    sums->yy = rounded(s_yy);
    sums->yz = s_yz;
    sums->zz = rounded(s_zz);
    sums->yyy = s_yyy;
    sums->yyz = s_yyz;
    sums->yzz = s_yzz;
    sums->zzz = s_zzz;
    sums->yyyy = s_yyyy;
    sums->yyyz = s_yyyz;
    sums->yyzz = s_yyzz;
    sums->yzzz = s_yzzz;
    sums->zzzz = s_zzzz;
}

FAST_CODE void moments_sum(const magnetometer_points_t *points, const int32_t anchor[3], moments_t *sums)
{
    sum_with_x(points, anchor, sums);
    sum_without_x(points, anchor, sums);
    sums->one = (float)points->count;
}

FAST_CODE void moments_merge(moments_t *into, const moments_t *from)
{
    float *const sums = (float *)into;
    const float *const more = (const float *)from;
    for (size_t i = 0; i < MOMENTS_FLOATS; i++) {
        sums[i] += more[i];
    }
}
