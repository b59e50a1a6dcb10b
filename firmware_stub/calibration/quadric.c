#include "quadric.h"

#include "fast_code.h"

#define SMALLEST_DETERMINANT 1.0e-6f

/* Larger levels are overflow on the way: no sensor's counts reach a radius of 1e15. */
#define LARGEST_LEVEL 1.0e30f

FAST_CODE bool quadric_ellipsoid(const quadric_t *quadric, ellipsoid_t *ellipsoid)
{
    const symmetric_t a = quadric->shape;
    const float gx = quadric->linear[0], gy = quadric->linear[1], gz = quadric->linear[2];

    /* Adjugate; its diagonal are the principal minors. */
    const float xx = a.yy * a.zz - a.yz * a.yz;
    const float xy = a.xz * a.yz - a.xy * a.zz;
    const float xz = a.xy * a.yz - a.xz * a.yy;
    const float yy = a.xx * a.zz - a.xz * a.xz;
    const float yz = a.xy * a.xz - a.xx * a.yz;
    const float zz = a.xx * a.yy - a.xy * a.xy;
    const float determinant = a.xx * xx + a.xy * xy + a.xz * xz;
    if (!(determinant > SMALLEST_DETERMINANT) || !(a.xx > 0.0f) || !(zz > 0.0f)) {
        return false;
    }
    /* centre = -1/2 A^-1 g, level = centre' A centre - j = -1/2 g . centre - j */
    const float scale = -0.5f / determinant;
    const float cx = scale * (xx * gx + xy * gy + xz * gz);
    const float cy = scale * (xy * gx + yy * gy + yz * gz);
    const float cz = scale * (xz * gx + yz * gy + zz * gz);
    const float level = -0.5f * (gx * cx + gy * cy + gz * cz) - quadric->constant;
    if (!(level > 0.0f) || !(level < LARGEST_LEVEL)) {
        return false;
    }
    ellipsoid->centre[0] = cx;
    ellipsoid->centre[1] = cy;
    ellipsoid->centre[2] = cz;
    ellipsoid->level = level;
    ellipsoid->minors = xx + yy + zz;
    ellipsoid->determinant = determinant;
    return true;
}
