#include "fit_result.h"

#include "fast_code.h"

/* Product of the diagonal over the determinant, which is the product of M_ii/d_i: it does not depend on the order of columns,
 * so a plane is found even when one column nearly explains another before it comes to the last. A plane leaves rounding, 1e6 or
 * more; points as thin as 0.3 % of their width leave 1e5. */
#define SPHERE_SINGULAR 1.0e5f

/* Radii outside are overflow, or one spot seen through rounding. */
#define LARGEST_SQUARE 1.0e30f

FAST_CODE void fit_nothing(fit_status_t status, magnetometer_fit_t *fit)
{
    fit->status = status;
    fit->is_sphere = 0;
    for (int i = 0; i < 9; i++) {
        fit->soft_iron[i] = (i % 4 == 0) ? 1.0f : 0.0f;
    }
    for (int axis = 0; axis < 3; axis++) {
        fit->hard_iron[axis] = 0.0f;
    }
}

/* Gaussian elimination without pivoting of the symmetric system held in the 5x4 rows of `m`, right-hand side last. */
static FAST_CODE bool solve_4(float m[FIT_SPHERE_UNKNOWNS + 1][FIT_SPHERE_UNKNOWNS], float t[FIT_SPHERE_UNKNOWNS])
{
    float ratio = 1.0f;
    for (int j = 0; j < FIT_SPHERE_UNKNOWNS; j++) {
        const float diagonal = m[j][j];
        for (int k = 0; k < j; k++) {
            const float scaled = m[j][k] / m[k][k];
            for (int i = j; i <= FIT_SPHERE_UNKNOWNS; i++) {
                m[i][j] -= m[i][k] * scaled;
            }
        }
        if (!(m[j][j] > 0.0f)) {
            return false;
        }
        ratio *= diagonal / m[j][j];
    }
    if (!(ratio < SPHERE_SINGULAR)) {
        return false;
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

FAST_CODE bool sphere_from_moments(const moments_t *sums, sphere_t *sphere)
{
    const moments_t *const s = sums;
    /* |p|^2 = (radius^2 - |centre|^2) + 2 centre . p. The constant is eliminated first: that moves the origin to the mean of the
     * points, where the pivots of points on a plane vanish whether the plane passes through the anchor or not. */
    float m[FIT_SPHERE_UNKNOWNS + 1][FIT_SPHERE_UNKNOWNS] = {
        {s->one, 0.0f, 0.0f, 0.0f},
        {s->x, s->xx, 0.0f, 0.0f},
        {s->y, s->xy, s->yy, 0.0f},
        {s->z, s->xz, s->yz, s->zz},
        {s->xx + s->yy + s->zz, s->xxx + s->xyy + s->xzz, s->xxy + s->yyy + s->yzz, s->xxz + s->yyz + s->zzz},
    };
    float t[FIT_SPHERE_UNKNOWNS];
    if (!solve_4(m, t)) {
        return false;
    }
    sphere->square = t[0] + 0.25f * (t[1] * t[1] + t[2] * t[2] + t[3] * t[3]);
    sphere->explained = 0.0f;
    for (int k = 0; k < FIT_SPHERE_UNKNOWNS; k++) {
        sphere->explained += m[FIT_SPHERE_UNKNOWNS][k] * m[FIT_SPHERE_UNKNOWNS][k] / m[k][k];
    }
    for (int axis = 0; axis < 3; axis++) {
        sphere->centre[axis] = 0.5f * t[axis + 1];
    }
    return sphere->square > 0.0f && sphere->square < LARGEST_SQUARE;
}
