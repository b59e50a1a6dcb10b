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

/* Rotate element (i, j) to zero, i < j. The matrix has three stretches: above row i, between the two, right of column j. */
static inline __attribute__((always_inline)) void annihilate(jacobi_t *m, int size, int i, int j)
{
    const float element = m->upper[i][j];
    const float cotangent = 0.5f * (m->values[j] - m->values[i]) / element; /* of twice the angle */
    const float root = __builtin_sqrtf(cotangent * cotangent + 1.0f);
    const float tangent = cotangent < 0.0f ? 1.0f / (cotangent - root) : 1.0f / (cotangent + root);
    const float cosine = 1.0f / __builtin_sqrtf(tangent * tangent + 1.0f);
    const rotation_t r = {cosine, tangent * cosine};

    m->values[i] -= tangent * element;
    m->values[j] += tangent * element;
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
#pragma GCC unroll 10
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
