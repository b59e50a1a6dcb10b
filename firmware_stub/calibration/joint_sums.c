#include "joint_sums.h"

#include <stddef.h>

#include "fast_code.h"

#if defined(__arm__)
_Static_assert(sizeof(joint_row_t) == 48u && sizeof(joint_component_t) == 88u, "the kernel steps over rows and sums of so many bytes");
_Static_assert(offsetof(joint_task_t, x) == 48u && offsetof(joint_task_t, dots) == 96u, "the kernel reads its task there");
#endif

static FAST_CODE void clear(joint_sums_t *sums)
{
    for (int i = 0; i < 3; i++) {
        joint_component_t *const c = &sums->components[i];
        c->one = c->n = c->o = c->nn = c->no = 0.0f;
        c->b_one = c->x = c->y = c->z = c->xx = c->xy = c->xz = c->yy = c->yz = 0.0f;
        for (int k = 0; k < 4; k++) {
            c->border[k] = c->target[k] = 0.0f;
        }
    }
}

FAST_CODE void joint_sum_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, const float x[12],
                               joint_row_t rows[JOINT_ROWS], joint_sums_t *sums)
{
    joint_task_t task;
    clear(sums);
    gravity_of(known, &task.gravity);
    for (int i = 0; i < 12; i++) {
        task.x[i] = x[i];
    }
    sums->dots = sums->squares = 0.0f;
    for (uint32_t first = 0; first < pairs->count; first += JOINT_ROWS) {
        const uint32_t left = pairs->count - first, count = left < JOINT_ROWS ? left : JOINT_ROWS;
        task.dots = task.squares = 0.0f; /* of 50 pairs, not of all: sums that grow round more */
        joint_make_rows(&task, &pairs->magnetometer[first], &pairs->accelerometer[first], count, rows);
        joint_add_rows(rows, count, sums->components);
        sums->dots += task.dots;
        sums->squares += task.squares;
    }
}
