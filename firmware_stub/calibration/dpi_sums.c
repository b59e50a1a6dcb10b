#include "dpi_sums.h"

#include "fast_code.h"
#include "gravity_row.h"

/* How many rows are made before they are added: to load and store the sums takes 216 cycles, whatever their number. */
#define ROWS 50u

#define INLINE GRAVITY_INLINE

/* Counts of both sensors at one instant, the magnetometer's relative to the anchor. */
typedef struct {
    float u[3];
    float a[3];
} counts_t;

INLINE counts_t pair_at(const dpi_pairs_t *pairs, const int32_t anchor[3], uint32_t index)
{
    const int16_t *const m = pairs->magnetometer[index];
    const int16_t *const a = pairs->accelerometer[index];
    return (counts_t){
        .u = {(float)(m[0] - anchor[0]), (float)(m[1] - anchor[1]), (float)(m[2] - anchor[2])},
        .a = {(float)a[0], (float)a[1], (float)a[2]},
    };
}

INLINE counts_t pose_at(const dpi_poses_t *poses, const float anchor[3], uint32_t index)
{
    const float *const m = poses->poses[index].magnetometer;
    const float *const a = poses->poses[index].accelerometer;
    return (counts_t){.u = {m[0] - anchor[0], m[1] - anchor[1], m[2] - anchor[2]}, .a = {a[0], a[1], a[2]}};
}

INLINE void store(const gravity_t *gravity, counts_t counts, dpi_row_t *row)
{
    const float *const gain = gravity->gain, *const at_zero = gravity->at_zero;
    const float x = gravity_component(gain, at_zero[0], counts.a), y = gravity_component(gain + 3, at_zero[1], counts.a),
                z = gravity_component(gain + 6, at_zero[2], counts.a);
    row->g[0] = x;
    row->g[1] = y;
    row->g[2] = z;
    row->u[0] = counts.u[0];
    row->u[1] = counts.u[1];
    row->u[2] = counts.u[2];
}

static FAST_CODE void clear(dpi_sums_t *sums)
{
    for (int i = 0; i < 3; i++) {
        clear_block(&sums->diagonal[i]);
        clear_block(&sums->beside[i]);
        for (int k = 0; k < 4; k++) {
            sums->target[i][k] = 0.0f;
        }
    }
}

INLINE uint32_t smaller(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

static FAST_CODE void anchor_of_pairs(const dpi_pairs_t *pairs, int32_t anchor[3], dpi_sums_t *sums)
{
    int32_t widest = 0;
    for (int axis = 0; axis < 3; axis++) {
        const int32_t low = pairs->minimum[axis], high = pairs->maximum[axis];
        anchor[axis] = (low + high) / 2;
        sums->anchor[axis] = (float)anchor[axis];
        widest = high - low > widest ? high - low : widest;
    }
    sums->unit = 0.5f * (float)widest;
}

FAST_CODE void dpi_sum_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, dpi_sums_t *sums)
{
    int32_t anchor[3];
    gravity_t gravity;
    dpi_row_t rows[ROWS];
    clear(sums);
    sums->count = pairs->count;
    gravity_of(known, &gravity);
    anchor_of_pairs(pairs, anchor, sums);
    for (uint32_t first = 0; first < pairs->count; first += ROWS) {
        const uint32_t count = smaller(pairs->count - first, ROWS);
        for (uint32_t index = 0; index < count; index++) {
            store(&gravity, pair_at(pairs, anchor, first + index), &rows[index]);
        }
        dpi_add_rows(rows, count, sums);
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
    gravity_t gravity;
    dpi_row_t rows[ROWS];
    clear(sums);
    sums->count = poses->count;
    gravity_of(known, &gravity);
    anchor_of_poses(poses, sums);
    for (uint32_t first = 0; first < poses->count; first += ROWS) {
        const uint32_t count = smaller(poses->count - first, ROWS);
        for (uint32_t index = 0; index < count; index++) {
            store(&gravity, pose_at(poses, sums->anchor, first + index), &rows[index]);
        }
        dpi_add_rows(rows, count, sums);
    }
}
