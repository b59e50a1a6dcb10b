#include "packed_points.h"

#include "fast_code.h"

FAST_CODE void packed_points_start(packed_points_t *packed, const int32_t anchor[3])
{
    for (int axis = 0; axis < 3; axis++) {
        packed->anchor[axis] = anchor[axis];
        packed->sums[axis] = 0;
    }
    packed->farthest = 0;
    packed->count = 0;
}

static inline int32_t larger(int32_t farthest, int32_t offset)
{
    const int32_t size = offset < 0 ? -offset : offset;
    return size > farthest ? size : farthest;
}

/* The first point of a pair leaves the other half zero, which is the anchor: it adds nothing to any sum. */
FAST_CODE stream_status_t packed_points_add(void *state, const int16_t point[3])
{
    packed_points_t *const packed = state;
    const uint32_t count = packed->count;
    if (count >= PACKED_POINTS_MAXIMUM) {
        return STREAM_FULL;
    }
    packed_pair_t *const pair = &packed->pairs[count / 2u];
    const int32_t x = point[0] - packed->anchor[0], y = point[1] - packed->anchor[1], z = point[2] - packed->anchor[2];
    if (count % 2u == 0u) {
        pair->x = (uint16_t)x;
        pair->y = (uint32_t)y << 16;
        pair->z = (uint16_t)z;
    } else {
        pair->x |= (uint32_t)x << 16;
        pair->y |= (uint16_t)y;
        pair->z |= (uint32_t)z << 16;
    }
    packed->sums[0] += x;
    packed->sums[1] += y;
    packed->sums[2] += z;
    packed->farthest = larger(larger(larger(packed->farthest, x), y), z);
    packed->count = count + 1u;
    return STREAM_OK;
}
