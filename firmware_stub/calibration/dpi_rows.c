#include "dpi_sums.h"

/* For a Cortex-M4 with FPU, dpi_rows_m4.S does the same operations on each sum in the same order. */
#if !(defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP))

#include "fast_code.h"

static FAST_CODE void add_block(dpi_block_t *block, float weight, const float u[3])
{
    const float x = weight * u[0], y = weight * u[1], z = weight * u[2];
    block->one += weight;
    block->x += x;
    block->y += y;
    block->z += z;
    block->xx += x * u[0];
    block->xy += x * u[1];
    block->xz += x * u[2];
    block->yy += y * u[1];
    block->yz += y * u[2];
    block->zz += z * u[2];
}

FAST_CODE void dpi_add_rows(const dpi_row_t *rows, uint32_t count, dpi_sums_t *sums)
{
    for (const dpi_row_t *row = rows; row < rows + count; row++) {
        for (int i = 0; i < 3; i++) {
            const float g = row->g[i], next = row->g[i == 2 ? 0 : i + 1];
            add_block(&sums->diagonal[i], g * g, row->u);
            add_block(&sums->beside[i], g * next, row->u);
            sums->target[i][0] += g;
            for (int k = 0; k < 3; k++) {
                sums->target[i][1 + k] += g * row->u[k];
            }
        }
    }
}

#endif
