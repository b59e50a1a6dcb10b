#include "gravity_equations.h"

#include "fast_code.h"

#define UNKNOWNS GRAVITY_UNKNOWNS

/* For a Cortex-M4 with FPU, gravity_equations_m4.S does the same operations in the same order. */
#if !(defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP))
FAST_CODE void gravity_reduce(float (*row)[GRAVITY_UNKNOWNS], const gravity_column_t *column, uint32_t rows, uint32_t number)
{
    float scaled[UNKNOWNS];
    const float share = column->share * column->border[number];
    for (uint32_t k = 0; k < UNKNOWNS; k++) {
        scaled[k] = k < number ? row[0][k] * column->reciprocals[k] : 0.0f;
    }
    for (uint32_t i = 0; i < rows; i++) {
        const float *const r = row[i];
        float value = r[number] - column->border[number + i] * share;
        for (uint32_t k = 0; k < number; k += 4u) {
            value -= (r[k] * scaled[k] + r[k + 1u] * scaled[k + 1u]) + (r[k + 2u] * scaled[k + 2u] + r[k + 3u] * scaled[k + 3u]);
        }
        row[i][number] = value;
    }
}
#else
_Static_assert(sizeof(gravity_column_t) == 104u, "gravity_reduce() reads its column there");
#endif

FAST_CODE float gravity_factor(gravity_equations_t m, gravity_column_t *column)
{
    float largest = 0.0f;
    for (uint32_t j = 0; j < UNKNOWNS; j++) {
        column->reciprocals[j] = 0.0f;
    }
    for (uint32_t j = 0; j < UNKNOWNS; j++) {
        gravity_reduce(&m[j], column, UNKNOWNS + 1u - j, j);
        const float pivot = m[j][j], inverse = 1.0f / pivot;
        const float ratio = (j % 4u == 0u ? 1.0f / 3.0f : 1.0f / 9.0f) * inverse;
        if (!(pivot > 0.0f) || !(ratio < LAST_PIVOT_LIMIT)) {
            return LAST_PIVOT_LIMIT;
        }
        column->reciprocals[j] = inverse;
        if (j < UNKNOWNS - 1u && ratio > largest) {
            largest = ratio;
        }
    }
    return largest;
}

FAST_CODE void gravity_substitute(gravity_equations_t m, const gravity_column_t *column, float x[UNKNOWNS])
{
    for (int i = UNKNOWNS - 1; i >= 0; i--) {
        float value = m[UNKNOWNS][i];
        for (int k = i + 1; k < UNKNOWNS; k++) {
            value -= m[k][i] * x[k];
        }
        x[i] = value * column->reciprocals[i];
    }
}

FAST_CODE float gravity_adjugate(const float x[UNKNOWNS], float adjugate[9])
{
    const float *const a = x + 1, *const b = x + 5, *const c = x + 9;
    adjugate[0] = b[1] * c[2] - b[2] * c[1];
    adjugate[1] = a[2] * c[1] - a[1] * c[2];
    adjugate[2] = a[1] * b[2] - a[2] * b[1];
    adjugate[3] = b[2] * c[0] - b[0] * c[2];
    adjugate[4] = a[0] * c[2] - a[2] * c[0];
    adjugate[5] = a[2] * b[0] - a[0] * b[2];
    adjugate[6] = b[0] * c[1] - b[1] * c[0];
    adjugate[7] = a[1] * c[0] - a[0] * c[1];
    adjugate[8] = a[0] * b[1] - a[1] * b[0];
    return a[0] * adjugate[0] + a[1] * adjugate[3] + a[2] * adjugate[6];
}

FAST_CODE void gravity_store(const gravity_solution_t *solution, float factor, magnetometer_fit_t *fit)
{
    const float *const x = solution->x;
    const float gain = factor / solution->unit, scale = solution->unit / solution->determinant;
    for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3; c++) {
            fit->soft_iron[3 * r + c] = gain * x[4 * r + 1 + c];
        }
        const float *const row = &solution->adjugate[3 * r];
        fit->hard_iron[r] = solution->anchor[r] - scale * (row[0] * x[0] + row[1] * x[4] + row[2] * x[8]);
    }
    fit->status = FIT_ELLIPSOID;
}
