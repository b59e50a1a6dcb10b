#include "packed_points.h"

#include <stddef.h>

#include "fast_code.h"

FAST_CODE void packed_points_start(packed_points_t *packed, const int32_t anchor[3])
{
    for (int axis = 0; axis < 3; axis++) {
        packed->anchor[axis] = anchor[axis];
        packed->block.first[axis] = 0;
    }
    packed->block.points = NULL;
    packed->block.pairs = packed->last = packed->pairs;
    packed->block.count = 0;
    packed->farthest = 0;
    packed_block_set_shift(PACKED_SHIFT_MAXIMUM, &packed->block);
}

static inline __attribute__((always_inline)) int32_t size(int32_t offset)
{
    return offset < 0 ? -offset : offset;
}

static inline __attribute__((always_inline)) int32_t larger(int32_t a, int32_t b)
{
    return a > b ? a : b;
}

/* The first point of a pair leaves the other half zero, which is the anchor: it adds nothing to any sum. */
FAST_CODE stream_status_t packed_points_add(void *state, const int16_t point[3])
{
    packed_points_t *const packed = state;
    packed_pair_t *const pair = packed->last;
    const uint32_t count = packed->block.count;
    const int32_t x = point[0] - packed->anchor[0], y = point[1] - packed->anchor[1], z = point[2] - packed->anchor[2];
    const int32_t most = larger(size(x), larger(size(y), size(z)));
    if (count >= PACKED_POINTS_MAXIMUM) {
        return STREAM_FULL;
    }
    if (__builtin_expect(most > packed->farthest, 0)) {
        if (most > INT16_MAX) {
            return STREAM_OUT_OF_RANGE;
        }
        packed->farthest = most;
        packed_block_set_shift(packed_block_largest_shift(most), &packed->block);
    }
    if (count % 2u == 0u) {
        pair->x = (uint16_t)x;
        pair->y = (uint32_t)y << 16;
        pair->z = (uint16_t)z;
    } else {
        pair->halves[1] = (int16_t)x;
        pair->halves[2] = (int16_t)y;
        pair->halves[5] = (int16_t)z;
        packed->last = pair + 1;
    }
    packed->block.first[0] += x;
    packed->block.first[1] += y;
    packed->block.first[2] += z;
    packed->block.count = count + 1u;
    return STREAM_OK;
}
