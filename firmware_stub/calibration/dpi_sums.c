#include "dpi_sums.h"

#include "fast_code.h"

/* 72 sums do not fit 32 registers, and in memory each costs a load and a store. Three passes of 24 keep most of them in registers:
 * a block of the diagonal, the one beside it and four of the target. Each pass needs two of the three components of gravity. */

#define INLINE static inline __attribute__((always_inline))

/* Counts of both sensors at one instant, the magnetometer's relative to the anchor. */
typedef struct {
    float u[3];
    float a[3];
} row_t;

INLINE row_t pair_at(const dpi_pairs_t *pairs, const int32_t anchor[3], uint32_t index)
{
    const int16_t *const m = pairs->magnetometer[index];
    const int16_t *const a = pairs->accelerometer[index];
    return (row_t){
        .u = {(float)(m[0] - anchor[0]), (float)(m[1] - anchor[1]), (float)(m[2] - anchor[2])},
        .a = {(float)a[0], (float)a[1], (float)a[2]},
    };
}

INLINE row_t pose_at(const dpi_poses_t *poses, const float anchor[3], uint32_t index)
{
    const float *const m = poses->poses[index].magnetometer;
    const float *const a = poses->poses[index].accelerometer;
    return (row_t){.u = {m[0] - anchor[0], m[1] - anchor[1], m[2] - anchor[2]}, .a = {a[0], a[1], a[2]}};
}

/* One component of gravity [g]: a row of the gain, and what the offset makes of it. */
INLINE float component(const float row[3], float at_zero, const float a[3])
{
    return row[0] * a[0] + row[1] * a[1] + row[2] * a[2] + at_zero;
}

INLINE void add_block(dpi_block_t *block, float weight, const float u[3])
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

INLINE void add_row(dpi_block_t *diagonal, dpi_block_t *beside, float target[4], float g, float next, const float u[3])
{
    add_block(diagonal, g * g, u);
    add_block(beside, g * next, u);
    target[0] += g;
    target[1] += g * u[0];
    target[2] += g * u[1];
    target[3] += g * u[2];
}

/* Gravity without acceleration counts: -gain * offset [g]. */
static FAST_CODE void gravity_at_zero(const dpi_known_t *known, float at_zero[3])
{
    for (int axis = 0; axis < 3; axis++) {
        at_zero[axis] = -component(&known->accelerometer.gain[3 * axis], 0.0f, known->accelerometer.offset);
    }
}

INLINE void store(dpi_sums_t *sums, int i, const dpi_block_t *diagonal, const dpi_block_t *beside, const float target[4])
{
    sums->diagonal[i] = *diagonal;
    sums->beside[i] = *beside;
    for (int k = 0; k < 4; k++) {
        sums->target[i][k] = target[k];
    }
}

static FAST_CODE void pass_over_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, const int32_t anchor[3],
                                      const float at_zero[3], int i, dpi_sums_t *sums)
{
    const int next = i == 2 ? 0 : i + 1;
    const float *const first_row = &known->accelerometer.gain[3 * i], *const next_row = &known->accelerometer.gain[3 * next];
    dpi_block_t diagonal = {0}, beside = {0};
    float target[4] = {0};
    for (uint32_t index = 0; index < pairs->count; index++) {
        const row_t row = pair_at(pairs, anchor, index);
        const float g = component(first_row, at_zero[i], row.a), h = component(next_row, at_zero[next], row.a);
        add_row(&diagonal, &beside, target, g, h, row.u);
    }
    store(sums, i, &diagonal, &beside, target);
}

FAST_CODE void dpi_sum_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, dpi_sums_t *sums)
{
    int32_t anchor[3], widest = 0;
    float at_zero[3];
    gravity_at_zero(known, at_zero);
    for (int axis = 0; axis < 3; axis++) {
        const int32_t low = pairs->minimum[axis], high = pairs->maximum[axis];
        anchor[axis] = (low + high) / 2;
        sums->anchor[axis] = (float)anchor[axis];
        widest = high - low > widest ? high - low : widest;
    }
    sums->unit = 0.5f * (float)widest;
    sums->count = pairs->count;
    for (int i = 0; i < 3; i++) {
        pass_over_pairs(pairs, known, anchor, at_zero, i, sums);
    }
}

static FAST_CODE void anchor_of_poses(const dpi_poses_t *poses, dpi_sums_t *sums)
{
    float widest = 0.0f;
    for (int axis = 0; axis < 3; axis++) {
        float low = poses->poses[0].magnetometer[axis], high = low;
        for (uint32_t index = 1; index < poses->count; index++) {
            const float value = poses->poses[index].magnetometer[axis];
            low = value < low ? value : low;
            high = value > high ? value : high;
        }
        sums->anchor[axis] = 0.5f * (low + high);
        widest = high - low > widest ? high - low : widest;
    }
    sums->unit = 0.5f * widest;
}

FAST_CODE void dpi_sum_poses(const dpi_poses_t *poses, const dpi_known_t *known, dpi_sums_t *sums)
{
    float at_zero[3];
    gravity_at_zero(known, at_zero);
    anchor_of_poses(poses, sums);
    sums->count = poses->count;
    for (int i = 0; i < 3; i++) {
        const int next = i == 2 ? 0 : i + 1;
        dpi_block_t diagonal = {0}, beside = {0};
        float target[4] = {0};
        for (uint32_t index = 0; index < poses->count; index++) {
            const row_t row = pose_at(poses, sums->anchor, index);
            const float g = component(&known->accelerometer.gain[3 * i], at_zero[i], row.a);
            const float h = component(&known->accelerometer.gain[3 * next], at_zero[next], row.a);
            add_row(&diagonal, &beside, target, g, h, row.u);
        }
        store(sums, i, &diagonal, &beside, target);
    }
}
