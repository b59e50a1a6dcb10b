#include "fit_result.h"

#include <stdbool.h>

#include "fast_code.h"

/* A pivot this much smaller than its diagonal element is rounding: the points are in a plane. */
#define SPHERE_SINGULAR 1.0e4f

/* Radii outside are overflow, or one spot seen through rounding. */
#define LARGEST_SQUARE 1.0e30f

static FAST_CODE void store(float scale, const float hard_iron[3], magnetometer_fit_t *fit)
{
    for (int i = 0; i < 9; i++) {
        fit->soft_iron[i] = (i % 4 == 0) ? scale : 0.0f;
    }
    for (int axis = 0; axis < 3; axis++) {
        fit->hard_iron[axis] = hard_iron[axis];
    }
}

FAST_CODE void fit_nothing(fit_status_t status, magnetometer_fit_t *fit)
{
    const float zero[3] = {0.0f, 0.0f, 0.0f};
    fit->status = status;
    fit->is_sphere = 0;
    store(1.0f, zero, fit);
}

/* Gaussian elimination without pivoting of the symmetric system held in the 5x4 rows of `m`, right-hand side last. */
static FAST_CODE bool solve_4(float m[FIT_SPHERE_UNKNOWNS + 1][FIT_SPHERE_UNKNOWNS], float t[FIT_SPHERE_UNKNOWNS])
{
    for (int j = 0; j < FIT_SPHERE_UNKNOWNS; j++) {
        const float diagonal = m[j][j];
        for (int k = 0; k < j; k++) {
            const float scaled = m[j][k] / m[k][k];
            for (int i = j; i <= FIT_SPHERE_UNKNOWNS; i++) {
                m[i][j] -= m[i][k] * scaled;
            }
        }
        if (!(m[j][j] * SPHERE_SINGULAR > diagonal)) {
            return false;
        }
    }
    for (int i = FIT_SPHERE_UNKNOWNS - 1; i >= 0; i--) {
        t[i] = m[FIT_SPHERE_UNKNOWNS][i];
        for (int k = i + 1; k < FIT_SPHERE_UNKNOWNS; k++) {
            t[i] -= m[k][i] * t[k];
        }
        t[i] /= m[i][i];
    }
    return true;
}

FAST_CODE void fit_sphere(const moments_t *sums, const int32_t anchor[3], fit_status_t status, magnetometer_fit_t *fit)
{
    const moments_t *const s = sums;
    /* |p|^2 = 2 centre . p + (radius^2 - |centre|^2), unknowns (2 centre, radius^2 - |centre|^2) */
    float m[FIT_SPHERE_UNKNOWNS + 1][FIT_SPHERE_UNKNOWNS] = {
        {s->xx, 0.0f, 0.0f, 0.0f},
        {s->xy, s->yy, 0.0f, 0.0f},
        {s->xz, s->yz, s->zz, 0.0f},
        {s->x, s->y, s->z, s->one},
        {s->xxx + s->xyy + s->xzz, s->xxy + s->yyy + s->yzz, s->xxz + s->yyz + s->zzz, s->xx + s->yy + s->zz},
    };
    float t[FIT_SPHERE_UNKNOWNS];
    if (!solve_4(m, t)) {
        fit_nothing(FIT_SINGULAR, fit);
        return;
    }
    const float square = t[3] + 0.25f * (t[0] * t[0] + t[1] * t[1] + t[2] * t[2]);
    if (!(square > 0.0f) || !(square < LARGEST_SQUARE)) {
        fit_nothing(FIT_SINGULAR, fit);
        return;
    }
    const float hard_iron[3] = {
        (float)anchor[0] + 0.5f * t[0],
        (float)anchor[1] + 0.5f * t[1],
        (float)anchor[2] + 0.5f * t[2],
    };
    fit->status = status;
    fit->is_sphere = 1;
    store(1.0f / __builtin_sqrtf(square), hard_iron, fit);
}
