#include "jacobi.h"

#include "fast_code.h"

#define NEGLIGIBLE 1.4901161e-8f /* 2^-26 */

typedef struct {
    float cosine, sine;
} rotation_t;

static inline __attribute__((always_inline)) void rotate(rotation_t r, float *first, float *second)
{
    const float a = *first, b = *second;
    *first = r.cosine * a - r.sine * b;
    *second = r.sine * a + r.cosine * b;
}

/* Rotate five elements that lie side by side in each of two rows. */
static inline __attribute__((always_inline)) void rotate_five(rotation_t r, float first[5], float second[5])
{
#if defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP)
    /* Loaded and stored together they take 6 cycles instead of 10, and pairs of them are in no need of waiting for each other. */
#define PRODUCTS(a, b, p, q)                                                                                                         \
    "vmul.f32 " p ", %[sine], " b "\n\tvmul.f32 " q ", %[sine], " a "\n\t"                                                           \
    "vmul.f32 " a ", %[cosine], " a "\n\tvmul.f32 " b ", %[cosine], " b "\n\t"
#define SUMS(a, b, p, q) "vsub.f32 " a ", " a ", " p "\n\tvadd.f32 " b ", " b ", " q "\n\t"
    __asm__ volatile("vldmia %[first], {s2-s6}\n\tvldmia %[second], {s7-s11}\n\t"
                     PRODUCTS("s2", "s7", "s12", "s13") SUMS("s2", "s7", "s12", "s13")
                     PRODUCTS("s3", "s8", "s14", "s15") SUMS("s3", "s8", "s14", "s15")
                     PRODUCTS("s4", "s9", "s12", "s13") SUMS("s4", "s9", "s12", "s13")
                     PRODUCTS("s5", "s10", "s14", "s15") SUMS("s5", "s10", "s14", "s15")
                     PRODUCTS("s6", "s11", "s12", "s13") SUMS("s6", "s11", "s12", "s13")
                     "vstmia %[first], {s2-s6}\n\tvstmia %[second], {s7-s11}"
                     :
                     : [first] "r"(first), [second] "r"(second), [sine] "t"(r.sine), [cosine] "t"(r.cosine)
                     : "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11", "s12", "s13", "s14", "s15", "memory");
#undef PRODUCTS
#undef SUMS
#else
    for (int k = 0; k < 5; k++) {
        rotate(r, &first[k], &second[k]);
    }
#endif
}

/* Rotate element (i, j) to zero, i < j. The matrix has three stretches: above row i, between the two, right of column j. */
static inline __attribute__((always_inline)) void annihilate(jacobi_t *m, int size, int i, int j)
{
    /* The cotangent of twice the angle is half / element; so its tangent is signed / far, and that triangle's long side the root of
     * their squares. */
    const float element = m->upper[i][j];
    const float half = 0.5f * (m->values[j] - m->values[i]);
    const float signed_element = half < 0.0f ? -element : element;
    const float far = __builtin_fabsf(half) + __builtin_sqrtf(half * half + element * element);
    const float long_side = __builtin_sqrtf(far * far + element * element);
    const float reciprocal = 1.0f / (far * long_side); /* one division for cosine, sine and tangent */
    const rotation_t r = {far * (reciprocal * far), signed_element * (reciprocal * far)};
    const float change = element * (signed_element * (reciprocal * long_side));

    m->values[i] -= change;
    m->values[j] += change;
    m->upper[i][j] = 0.0f;
    for (int k = 0; k < i; k++) {
        rotate(r, &m->upper[k][i], &m->upper[k][j]);
    }
    for (int k = i + 1; k < j; k++) {
        rotate(r, &m->upper[i][k], &m->upper[k][j]);
    }
    for (int k = j + 1; k < size; k++) {
        rotate(r, &m->upper[i][k], &m->upper[j][k]);
    }
    if (size == JACOBI_LARGEST) {
        rotate_five(r, &m->vectors[i][0], &m->vectors[j][0]);
        rotate_five(r, &m->vectors[i][5], &m->vectors[j][5]);
        return;
    }
    for (int k = 0; k < size; k++) {
        rotate(r, &m->vectors[i][k], &m->vectors[j][k]);
    }
}

/* One pass over all elements above the diagonal. Returns whether any was rotated. */
static inline __attribute__((always_inline)) bool sweep(jacobi_t *m, int size, float negligible)
{
    bool rotated = false;
    for (int i = 0; i < size - 1; i++) {
        for (int j = i + 1; j < size; j++) {
            if (__builtin_fabsf(m->upper[i][j]) > negligible) {
                annihilate(m, size, i, j);
                rotated = true;
            }
        }
    }
    return rotated;
}

/* Identity for the vectors; returns what is negligible beside the diagonal. */
static inline __attribute__((always_inline)) float start(jacobi_t *matrix, int size)
{
    float sum = 0.0f;
    for (int i = 0; i < size; i++) {
        sum += __builtin_fabsf(matrix->values[i]);
        for (int k = 0; k < size; k++) {
            matrix->vectors[i][k] = (i == k) ? 1.0f : 0.0f;
        }
    }
    return NEGLIGIBLE * sum;
}

static inline __attribute__((always_inline)) uint16_t diagonalise(jacobi_t *matrix, int size, uint16_t limit)
{
    const float negligible = start(matrix, size);
    uint16_t sweeps = 0;
    while (sweeps < limit && sweep(matrix, size, negligible)) {
        sweeps++;
    }
    return sweeps;
}

FAST_CODE uint16_t jacobi_diagonalise(jacobi_t *matrix, int size, uint16_t limit)
{
    /* A copy for the largest size, where it is known how often the loops run. */
    return size == JACOBI_LARGEST ? diagonalise(matrix, JACOBI_LARGEST, limit) : diagonalise(matrix, size, limit);
}

FAST_CODE float jacobi_start(jacobi_t *matrix, int size)
{
    return start(matrix, size);
}

FAST_CODE bool jacobi_rotate(jacobi_t *matrix, int size, int i, int j, float negligible)
{
    const bool counts = __builtin_fabsf(matrix->upper[i][j]) > negligible;
    if (counts) {
        annihilate(matrix, size, i, j);
    }
    return counts;
}
