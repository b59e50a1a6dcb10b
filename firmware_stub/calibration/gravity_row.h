/**
 * @file gravity_row.h
 * @brief Gravity from acceleration counts, and sums of rows before the first one; inline, so that each loop is compiled whole.
 */
#ifndef HILTEST_GRAVITY_ROW_H
#define HILTEST_GRAVITY_ROW_H

#include "dpi_sums.h"

#define GRAVITY_INLINE static inline __attribute__((always_inline))

/** The factors from acceleration counts to gravity [g]. A copy stays in registers, because the memory of the rows cannot overlap it. */
typedef struct {
    float gain[9];
    float at_zero[3]; /**< gravity without acceleration counts: -gain * offset */
} gravity_t;

/** One component of gravity [g]: a row of the gain, and what the offset makes of it. */
GRAVITY_INLINE float gravity_component(const float row[3], float at_zero, const float a[3])
{
    return row[0] * a[0] + row[1] * a[1] + row[2] * a[2] + at_zero;
}

GRAVITY_INLINE void gravity_of(const dpi_known_t *known, gravity_t *gravity)
{
    const accelerometer_calibration_t *const it = &known->accelerometer;
    for (int axis = 0; axis < 3; axis++) {
        const float *const row = &it->gain[3 * axis];
        for (int k = 0; k < 3; k++) {
            gravity->gain[3 * axis + k] = row[k];
        }
        gravity->at_zero[axis] = -gravity_component(row, 0.0f, it->offset);
    }
}

GRAVITY_INLINE void clear_block(dpi_block_t *block)
{
    block->one = block->x = block->y = block->z = 0.0f;
    block->xx = block->xy = block->xz = block->yy = block->yz = block->zz = 0.0f;
}

#endif
