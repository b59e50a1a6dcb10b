#include "exact_moments.h"

#include "fast_code.h"

#define INLINE static inline __attribute__((always_inline))

#define LARGEST_DEGREE 4

/* Every loop is unrolled completely, so that indices become addresses: 5 kB of code, and a quarter of the time of rolled ones. */

/* The sums by the powers of x, y and z, 64 bits each. */
typedef uint64_t powers_t[LARGEST_DEGREE + 1][LARGEST_DEGREE + 1][LARGEST_DEGREE + 1];

INLINE uint64_t joined(wide_sum_t sum)
{
    return (uint64_t)sum.high << 32 | sum.low;
}

INLINE uint64_t extended(uint32_t sum)
{
    return (uint64_t)(int64_t)(int32_t)sum;
}

INLINE uint64_t sum_of(const exact_moments_t *sums, int degree, int index)
{
    return degree == 4   ? joined(sums->fourth[index])
           : degree == 3 ? joined(sums->third[index])
           : degree == 2 ? extended(sums->second[index])
                         : extended(sums->first[index]);
}

INLINE void by_powers(const exact_moments_t *sums, uint16_t count, powers_t m)
{
    m[0][0][0] = count;
#pragma GCC unroll 5
    for (int degree = 1; degree <= LARGEST_DEGREE; degree++) {
        int index = 0;
#pragma GCC unroll 5
        for (int x = degree; x >= 0; x--) {
#pragma GCC unroll 5
            for (int y = degree - x; y >= 0; y--) {
                m[x][y][degree - x - y] = sum_of(sums, degree, index++);
            }
        }
    }
}

/* Move the origin of one coordinate by t. The sums of a monomial times that coordinate's powers 0 to `last` lie `stride` apart;
 * the k-th becomes sum (k over i) (-t)^(k-i) m_i, by steps m_k -= t m_(k-1) from the last power down, once less far each time. */
INLINE void shift(uint64_t *m, int stride, int last, int32_t t)
{
    const uint64_t step = (uint64_t)(int64_t)t;
#pragma GCC unroll 5
    for (int first = 1; first <= last; first++) {
#pragma GCC unroll 5
        for (int k = last; k >= first; k--) {
            m[k * stride] -= step * m[(k - 1) * stride];
        }
    }
}

/* Of one coordinate, with all powers of the two others, whose powers lie `one` and `other` apart. One copy for all three saves 2 KiB of
 * fast code. */
static FAST_CODE __attribute__((noinline)) void shift_axis(uint64_t *m, int stride, int one, int other, int32_t t)
{
#pragma GCC unroll 5
    for (int first = 0; first < 4; first++) {
#pragma GCC unroll 5
        for (int second = 0; first + second < 4; second++) {
            shift(&m[first * one + second * other], stride, 4 - first - second, t);
        }
    }
}

/* In two words, each converted exactly or nearly so. One that fits 32 bits must not go that way: its upper word would be -1 and
 * its lower one close to 2^32, where float32 steps by 256. 34 calls take 1.3 KiB less of fast code than 34 copies. */
static FAST_CODE __attribute__((noinline)) float rounded(uint64_t value)
{
    const int32_t low = (int32_t)value;
    if ((int64_t)value == low) {
        return (float)low;
    }
    return (float)(int32_t)(value >> 32) * 4294967296.0f + (float)(uint32_t)value;
}

INLINE void to_float(powers_t m, moments_t *moments)
{
    float *sum = (float *)moments; /* one, then degree by degree in the same order */
    *sum++ = (float)(uint32_t)m[0][0][0];
#pragma GCC unroll 5
    for (int degree = 1; degree <= LARGEST_DEGREE; degree++) {
#pragma GCC unroll 5
        for (int x = degree; x >= 0; x--) {
#pragma GCC unroll 5
            for (int y = degree - x; y >= 0; y--) {
                *sum++ = rounded(m[x][y][degree - x - y]);
            }
        }
    }
}

FAST_CODE void exact_moments_about_mean(const exact_moments_t *sums, uint16_t count, int32_t mean[3], moments_t *moments)
{
    powers_t m;
    by_powers(sums, count, m);
#pragma GCC unroll 5
    for (int axis = 0; axis < 3; axis++) {
        mean[axis] = (int32_t)sums->first[axis] / count;
    }
    shift_axis(&m[0][0][0], 25, 5, 1, mean[0]);
    shift_axis(&m[0][0][0], 5, 25, 1, mean[1]);
    shift_axis(&m[0][0][0], 1, 25, 5, mean[2]);
    to_float(m, moments);
}
