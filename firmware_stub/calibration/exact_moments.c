#include "exact_moments.h"

#include "fast_code.h"

#define INLINE static inline __attribute__((always_inline))

INLINE uint64_t product(int32_t a, int32_t b)
{
    return (uint64_t)((int64_t)a * b);
}

/* Add sign times every monomial. The sign goes into one factor of each product, so removing costs six negations more. */
INLINE void accumulate(exact_moments_t *s, int32_t x, int32_t y, int32_t z, int32_t sign)
{
    const int32_t xx = x * x, xy = x * y, xz = x * z, yy = y * y, yz = y * z, zz = z * z;
    const int32_t sxx = sign * xx, sxy = sign * xy, sxz = sign * xz, syy = sign * yy, syz = sign * yz, szz = sign * zz;
    s->x += (uint32_t)(sign * x);
    s->y += (uint32_t)(sign * y);
    s->z += (uint32_t)(sign * z);
    s->xx += (uint32_t)sxx;
    s->xy += (uint32_t)sxy;
    s->xz += (uint32_t)sxz;
    s->yy += (uint32_t)syy;
    s->yz += (uint32_t)syz;
    s->zz += (uint32_t)szz;
    s->xxx += product(sxx, x);
    s->xxy += product(sxx, y);
    s->xxz += product(sxx, z);
    s->xyy += product(syy, x);
    s->xyz += product(sxy, z);
    s->xzz += product(szz, x);
    s->yyy += product(syy, y);
    s->yyz += product(syy, z);
    s->yzz += product(szz, y);
    s->zzz += product(szz, z);
    s->xxxx += product(sxx, xx);
    s->xxxy += product(sxx, xy);
    s->xxxz += product(sxx, xz);
    s->xxyy += product(sxx, yy);
    s->xxyz += product(sxx, yz);
    s->xxzz += product(sxx, zz);
    s->xyyy += product(syy, xy);
    s->xyyz += product(syy, xz);
    s->xyzz += product(szz, xy);
    s->xzzz += product(szz, xz);
    s->yyyy += product(syy, yy);
    s->yyyz += product(syy, yz);
    s->yyzz += product(syy, zz);
    s->yzzz += product(szz, yz);
    s->zzzz += product(szz, zz);
}

FAST_CODE void exact_moments_add(exact_moments_t *sums, int32_t x, int32_t y, int32_t z)
{
    accumulate(sums, x, y, z, 1);
}

FAST_CODE void exact_moments_remove(exact_moments_t *sums, int32_t x, int32_t y, int32_t z)
{
    accumulate(sums, x, y, z, -1);
}

/* The same sums by the powers of x, y and z, 64 bits each. */
typedef uint64_t wide_moments_t[5][5][5];

static FAST_CODE void widen(const exact_moments_t *s, uint16_t count, wide_moments_t m)
{
    m[0][0][0] = count;
    m[1][0][0] = (uint64_t)(int32_t)s->x; m[0][1][0] = (uint64_t)(int32_t)s->y; m[0][0][1] = (uint64_t)(int32_t)s->z;
    m[2][0][0] = (uint64_t)(int32_t)s->xx; m[1][1][0] = (uint64_t)(int32_t)s->xy; m[1][0][1] = (uint64_t)(int32_t)s->xz;
    m[0][2][0] = (uint64_t)(int32_t)s->yy; m[0][1][1] = (uint64_t)(int32_t)s->yz; m[0][0][2] = (uint64_t)(int32_t)s->zz;
    m[3][0][0] = s->xxx; m[2][1][0] = s->xxy; m[2][0][1] = s->xxz; m[1][2][0] = s->xyy; m[1][1][1] = s->xyz;
    m[1][0][2] = s->xzz; m[0][3][0] = s->yyy; m[0][2][1] = s->yyz; m[0][1][2] = s->yzz; m[0][0][3] = s->zzz;
    m[4][0][0] = s->xxxx; m[3][1][0] = s->xxxy; m[3][0][1] = s->xxxz; m[2][2][0] = s->xxyy; m[2][1][1] = s->xxyz;
    m[2][0][2] = s->xxzz; m[1][3][0] = s->xyyy; m[1][2][1] = s->xyyz; m[1][1][2] = s->xyzz; m[1][0][3] = s->xzzz;
    m[0][4][0] = s->yyyy; m[0][3][1] = s->yyyz; m[0][2][2] = s->yyzz; m[0][1][3] = s->yzzz; m[0][0][4] = s->zzzz;
}

/* Move the origin of one coordinate by t. The sums of a monomial times that coordinate's powers 0 to `last` lie `stride` apart;
 * the k-th becomes sum (k over i) (-t)^(k-i) m_i, by steps m_k -= t m_(k-1) from the last power down, once less far each time. */
static FAST_CODE void shift(uint64_t *m, int stride, int last, int32_t t)
{
    const uint64_t step = (uint64_t)(int64_t)t;
    for (int first = 1; first <= last; first++) {
        for (int k = last; k >= first; k--) {
            m[k * stride] -= step * m[(k - 1) * stride];
        }
    }
}

/* Of one coordinate, with all powers of the two others, whose powers lie `one` and `other` apart. */
static FAST_CODE void shift_axis(uint64_t *m, int stride, int one, int other, int32_t t)
{
    for (int first = 0; first < 4; first++) {
        for (int second = 0; first + second < 4; second++) {
            shift(&m[first * one + second * other], stride, 4 - first - second, t);
        }
    }
}

/* In two words, each converted exactly or nearly so. One that fits 32 bits must not go that way: its upper word would be -1 and
 * its lower one close to 2^32, where float32 steps by 256. */
INLINE float rounded(uint64_t value)
{
    const int32_t low = (int32_t)value;
    if ((int64_t)value == low) {
        return (float)low;
    }
    return (float)(int32_t)(value >> 32) * 4294967296.0f + (float)(uint32_t)value;
}

static FAST_CODE void narrow(wide_moments_t m, moments_t *out)
{
    out->one = rounded(m[0][0][0]);
    out->x = rounded(m[1][0][0]); out->y = rounded(m[0][1][0]); out->z = rounded(m[0][0][1]); out->xx = rounded(m[2][0][0]);
    out->xy = rounded(m[1][1][0]); out->xz = rounded(m[1][0][1]); out->yy = rounded(m[0][2][0]);
    out->yz = rounded(m[0][1][1]); out->zz = rounded(m[0][0][2]); out->xxx = rounded(m[3][0][0]);
    out->xxy = rounded(m[2][1][0]); out->xxz = rounded(m[2][0][1]); out->xyy = rounded(m[1][2][0]);
    out->xyz = rounded(m[1][1][1]); out->xzz = rounded(m[1][0][2]); out->yyy = rounded(m[0][3][0]);
    out->yyz = rounded(m[0][2][1]); out->yzz = rounded(m[0][1][2]); out->zzz = rounded(m[0][0][3]);
    out->xxxx = rounded(m[4][0][0]); out->xxxy = rounded(m[3][1][0]); out->xxxz = rounded(m[3][0][1]);
    out->xxyy = rounded(m[2][2][0]); out->xxyz = rounded(m[2][1][1]); out->xxzz = rounded(m[2][0][2]);
    out->xyyy = rounded(m[1][3][0]); out->xyyz = rounded(m[1][2][1]); out->xyzz = rounded(m[1][1][2]);
    out->xzzz = rounded(m[1][0][3]); out->yyyy = rounded(m[0][4][0]); out->yyyz = rounded(m[0][3][1]);
    out->yyzz = rounded(m[0][2][2]); out->yzzz = rounded(m[0][1][3]); out->zzzz = rounded(m[0][0][4]);
}

FAST_CODE void exact_moments_about_mean(const exact_moments_t *sums, uint16_t count, int32_t mean[3], moments_t *moments)
{
    wide_moments_t m;
    widen(sums, count, m);
    mean[0] = (int32_t)sums->x / count;
    mean[1] = (int32_t)sums->y / count;
    mean[2] = (int32_t)sums->z / count;
    shift_axis(&m[0][0][0], 25, 5, 1, mean[0]);
    shift_axis(&m[0][0][0], 5, 25, 1, mean[1]);
    shift_axis(&m[0][0][0], 1, 25, 5, mean[2]);
    narrow(m, moments);
}
