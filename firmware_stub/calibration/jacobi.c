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

#if defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP)
/* The elements of two rows, loaded and stored together: that takes 11 cycles a row instead of 20, and of the two elements of a pair
 * none waits for the other. */
#define PAIR(a, b, p, q)                                                                                                             \
    "vmul.f32 " p ", %[sine], " b "\n\tvmul.f32 " q ", %[sine], " a "\n\t"                                                           \
    "vmul.f32 " a ", %[cosine], " a "\n\tvmul.f32 " b ", %[cosine], " b "\n\t"                                                       \
    "vsub.f32 " a ", " a ", " p "\n\tvadd.f32 " b ", " b ", " q "\n\t"
#define ROTATE_TEN                                                                                                                   \
    "vldmia %[first], {s2-s11}\n\tvldmia %[second], {s12-s21}\n\t"                                                                   \
    PAIR("s2", "s12", "s22", "s23") PAIR("s3", "s13", "s24", "s25")                                                                  \
    PAIR("s4", "s14", "s22", "s23") PAIR("s5", "s15", "s24", "s25")                                                                  \
    PAIR("s6", "s16", "s22", "s23") PAIR("s7", "s17", "s24", "s25")                                                                  \
    PAIR("s8", "s18", "s22", "s23") PAIR("s9", "s19", "s24", "s25")                                                                  \
    PAIR("s10", "s20", "s22", "s23") PAIR("s11", "s21", "s24", "s25")                                                                \
    "vstmia %[first], {s2-s11}\n\tvstmia %[second], {s12-s21}\n\t"
_Static_assert(sizeof(float[JACOBI_LARGEST]) == 40u, "COPY_TO_COLUMNS goes down a column in steps of a row");
#define COPY_TO_COLUMNS                                                                                                              \
    "vstr s2, [%[left]]\n\tvstr s3, [%[left], #40]\n\t"                                                                              \
    "vstr s4, [%[left], #80]\n\tvstr s5, [%[left], #120]\n\t"                                                                        \
    "vstr s6, [%[left], #160]\n\tvstr s7, [%[left], #200]\n\t"                                                                       \
    "vstr s8, [%[left], #240]\n\tvstr s9, [%[left], #280]\n\t"                                                                       \
    "vstr s10, [%[left], #320]\n\tvstr s11, [%[left], #360]\n\t"                                                                     \
    "vstr s12, [%[right]]\n\tvstr s13, [%[right], #40]\n\t"                                                                          \
    "vstr s14, [%[right], #80]\n\tvstr s15, [%[right], #120]\n\t"                                                                    \
    "vstr s16, [%[right], #160]\n\tvstr s17, [%[right], #200]\n\t"                                                                   \
    "vstr s18, [%[right], #240]\n\tvstr s19, [%[right], #280]\n\t"                                                                   \
    "vstr s20, [%[right], #320]\n\tvstr s21, [%[right], #360]\n\t"
#define TEN_CLOBBERED                                                                                                                \
    "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11", "s12", "s13", "s14", "s15", "s16", "s17", "s18", "s19", "s20",     \
        "s21", "s22", "s23", "s24", "s25", "memory"

static inline __attribute__((always_inline)) void rotate_vectors(rotation_t r, jacobi_t *m, int i, int j)
{
    __asm__ volatile(ROTATE_TEN
                     :
                     : [first] "r"(m->vectors[i]), [second] "r"(m->vectors[j]), [sine] "t"(r.sine), [cosine] "t"(r.cosine)
                     : TEN_CLOBBERED);
}

/* Both rows, and from them both columns. */
static inline __attribute__((always_inline)) void rotate_matrix(rotation_t r, jacobi_t *m, int i, int j)
{
    __asm__ volatile(ROTATE_TEN COPY_TO_COLUMNS
                     :
                     : [first] "r"(m->upper[i]), [second] "r"(m->upper[j]), [left] "r"(&m->upper[0][i]),
                       [right] "r"(&m->upper[0][j]), [sine] "t"(r.sine), [cosine] "t"(r.cosine)
                     : TEN_CLOBBERED);
}
#else
static inline void rotate_vectors(rotation_t r, jacobi_t *m, int i, int j)
{
    for (int k = 0; k < JACOBI_LARGEST; k++) {
        rotate(r, &m->vectors[i][k], &m->vectors[j][k]);
    }
}

static inline void rotate_matrix(rotation_t r, jacobi_t *m, int i, int j)
{
    for (int k = 0; k < JACOBI_LARGEST; k++) {
        rotate(r, &m->upper[i][k], &m->upper[j][k]);
        m->upper[k][i] = m->upper[i][k];
        m->upper[k][j] = m->upper[j][k];
    }
}
#endif

/* The largest matrix is kept whole, both halves of it: then its rows are rotated in one loop. Its diagonal after that
 * is never read. */
static inline __attribute__((always_inline)) void rotate_largest(rotation_t r, jacobi_t *m, int i, int j)
{
    rotate_matrix(r, m, i, j);
    m->upper[i][j] = m->upper[j][i] = 0.0f;
    rotate_vectors(r, m, i, j);
}

/* Of a smaller one there are three stretches: above row i, between the two, right of column j. */
static inline __attribute__((always_inline)) void rotate_smaller(rotation_t r, jacobi_t *m, int size, int i, int j)
{
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
    for (int k = 0; k < size; k++) {
        rotate(r, &m->vectors[i][k], &m->vectors[j][k]);
    }
}

/* Rotate element (i, j) to zero, i < j. */
static inline __attribute__((always_inline)) void annihilate(jacobi_t *m, int size, int i, int j)
{
    /* The cotangent of twice the angle is half / element; so its tangent is signed / far, and that triangle's long side the root of
     * their squares. */
    const float element = m->upper[i][j];
    const float half = 0.5f * (m->values[j] - m->values[i]);
    const float signed_element = has_minus(half) ? -element : element;
    const float far = __builtin_fabsf(half) + __builtin_sqrtf(half * half + element * element);
    const float long_side = __builtin_sqrtf(far * far + element * element);
    const float reciprocal = 1.0f / (far * long_side); /* one division for cosine, sine and tangent */
    const rotation_t r = {far * (reciprocal * far), signed_element * (reciprocal * far)};
    const float change = element * (signed_element * (reciprocal * long_side));

    m->values[i] -= change;
    m->values[j] += change;
    if (size == JACOBI_LARGEST) {
        rotate_largest(r, m, i, j);
    } else {
        rotate_smaller(r, m, size, i, j);
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

/* The other half of the largest matrix, and the diagonal of what is rotated with it. */
static inline __attribute__((always_inline)) void fill(jacobi_t *m)
{
#pragma GCC unroll 10
    for (int i = 0; i < JACOBI_LARGEST; i++) {
        m->upper[i][i] = 0.0f;
#pragma GCC unroll 10
        for (int k = 0; k < i; k++) {
            m->upper[i][k] = m->upper[k][i];
        }
    }
}

/* Identity for the vectors; returns what is negligible beside the diagonal. */
static inline __attribute__((always_inline)) float start(jacobi_t *matrix, int size)
{
    float sum = 0.0f;
    if (size == JACOBI_LARGEST) {
        fill(matrix);
    }
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
