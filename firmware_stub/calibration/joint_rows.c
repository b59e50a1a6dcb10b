#include "joint_sums.h"

/* For a Cortex-M4 with FPU, joint_rows_m4.S does the same operations on each number in the same order. */
#if !(defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP))

#include "fast_code.h"

GRAVITY_INLINE float dot(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

FAST_CODE void joint_make_rows(joint_task_t *task, const int16_t (*magnetometer)[3], const int16_t (*accelerometer)[3], uint32_t count,
                               joint_row_t *rows)
{
    const float *const x = task->x;
    for (uint32_t index = 0; index < count; index++) {
        joint_row_t *const row = &rows[index];
        float g[3], *const u = row->u, *const t = row->t;
        for (int r = 0; r < 3; r++) {
            const float m[3] = {(float)magnetometer[index][0], (float)magnetometer[index][1], (float)magnetometer[index][2]};
            const float a[3] = {(float)accelerometer[index][0], (float)accelerometer[index][1], (float)accelerometer[index][2]};
            g[r] = gravity_component(&task->gravity.gain[3 * r], task->gravity.at_zero[r], a);
            u[r] = x[4 * r] + x[4 * r + 1] * m[0] + x[4 * r + 2] * m[1] + x[4 * r + 3] * m[2];
        }
        /* 1 / |u| to the second order of |u|^2 - 1: noise of a tenth of the field leaves 0.2 %. Gravity has less, so the first order does. */
        const float excess = dot(u, u) - 1.0f, scale = 1.0f - excess * (0.5f - 0.375f * excess);
        const float gravity_scale = 1.5f - 0.5f * dot(g, g);
        for (int r = 0; r < 3; r++) {
            u[r] *= scale;
            g[r] *= gravity_scale;
        }
        const float sine = dot(u, g);
        const float stretched = excess * (0.5f - 0.125f * excess); /* |f| - 1 */
        const float weighted = (1.0f - sine * sine) * stretched;
        task->dots += sine;
        task->squares += sine * sine;
        task->squares += weighted * stretched;
        t[0] = u[1] * g[2] - u[2] * g[1];
        t[1] = u[2] * g[0] - u[0] * g[2];
        t[2] = u[0] * g[1] - u[1] * g[0];
        for (int r = 0; r < 3; r++) {
            const float p = g[r] - sine * u[r];
            row->p_h[r][0] = p;
            row->p_h[r][1] = weighted * u[r] + sine * p;
        }
    }
}

static FAST_CODE void add_row(const joint_row_t *row, int i, joint_component_t *c)
{
    const int next = i == 2 ? 0 : i + 1, third = i == 0 ? 2 : i - 1;
    const float x = row->u[0], y = row->u[1], z = row->u[2], n = row->u[next], o = row->u[third];
    const float own = row->t[i] * row->t[i], beside = row->t[i] * row->t[next], p = row->p_h[i][0], h = row->p_h[i][1];
    const float own_n = own * n, bx = beside * x, by = beside * y;
    c->one += own;
    c->n += own_n;
    c->o += own * o;
    c->nn += own_n * n;
    c->no += own_n * o;
    c->b_one += beside;
    c->x += bx;
    c->y += by;
    c->z += beside * z;
    c->xx += bx * x;
    c->xy += bx * y;
    c->xz += bx * z;
    c->yy += by * y;
    c->yz += by * z;
    c->border[0] += p;
    c->border[1] += p * x;
    c->border[2] += p * y;
    c->border[3] += p * z;
    c->target[0] += h;
    c->target[1] += h * x;
    c->target[2] += h * y;
    c->target[3] += h * z;
}

FAST_CODE void joint_add_rows(const joint_row_t *rows, uint32_t count, joint_component_t components[3])
{
    for (uint32_t index = 0; index < count; index++) {
        for (int i = 0; i < 3; i++) {
            add_row(&rows[index], i, &components[i]);
        }
    }
}

#endif
