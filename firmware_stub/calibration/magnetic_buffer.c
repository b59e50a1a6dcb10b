#include "magnetic_buffer.h"

#include <stdbool.h>

#include "fast_code.h"

/* 100 tan of -90 degrees + 180/14 i, fractions cut off: what separates one row, or one half row, from the next. Unrolled into
 * constants, it is no table in flash, which fast code does not read. */
static const int16_t limits[MAGNETIC_BUFFER_ROWS - 1] = {-438, -207, -125, -79, -48, -22, 0, 22, 48, 79, 125, 207, 438};

/* Number of limits up to 100 numerator / denominator. The ratio is cut to 16 bits, as in the libraries: a steep one wraps. */
static inline __attribute__((always_inline)) int32_t strip(int32_t numerator, int32_t denominator)
{
    const int16_t ratio = (int16_t)(100 * numerator / denominator);
    int32_t index = 0;
#pragma GCC unroll 13
    for (int i = 0; i < MAGNETIC_BUFFER_ROWS - 1; i++) {
        index += limits[i] <= ratio;
    }
    return index;
}

FAST_CODE int32_t magnetic_buffer_cell(int32_t x, int32_t y, int32_t z)
{
    if (z == 0) {
        return MAGNETIC_BUFFER_NO_CELL;
    }
    return strip(x, z) * MAGNETIC_BUFFER_ROW_CELLS + strip(y, z) + (x < 0 ? MAGNETIC_BUFFER_ROWS : 0);
}

static inline int32_t distance(int16_t a, int16_t b)
{
    return a < b ? b - a : a - b;
}

static inline __attribute__((always_inline)) bool is_near(const int16_t a[3], const int16_t b[3])
{
    return distance(a[0], b[0]) + distance(a[1], b[1]) + distance(a[2], b[2]) < MAGNETIC_BUFFER_MESH;
}

static inline void put(magnetic_buffer_t *buffer, int32_t cell, const int16_t point[3], uint32_t time)
{
    buffer->points[cell][0] = point[0];
    buffer->points[cell][1] = point[1];
    buffer->points[cell][2] = point[2];
    buffer->stored[cell] = time;
}

/* Empty the cell that was stored first. */
static FAST_CODE void free_oldest(magnetic_buffer_t *buffer)
{
    int32_t oldest = 0;
    uint32_t time = UINT32_MAX;
    for (int32_t cell = 0; cell < MAGNETIC_BUFFER_CELLS; cell++) {
        const uint32_t stored = buffer->stored[cell] - 1u; /* an empty cell becomes the latest of all */
        if (stored < time) {
            time = stored;
            oldest = cell;
        }
    }
    buffer->stored[oldest] = 0;
}

/* The last empty cell, or MAGNETIC_BUFFER_NO_CELL when some point held is near. */
static FAST_CODE int32_t cell_to_spare(const magnetic_buffer_t *buffer, const int16_t point[3])
{
    int32_t spare = MAGNETIC_BUFFER_NO_CELL;
#pragma GCC unroll 8 /* of an empty cell the loop would be most */
    for (int32_t cell = 0; cell < MAGNETIC_BUFFER_CELLS; cell++) {
        if (buffer->stored[cell] == 0u) {
            spare = cell;
        } else if (is_near(buffer->points[cell], point)) {
            return MAGNETIC_BUFFER_NO_CELL;
        }
    }
    return spare;
}

FAST_CODE void magnetic_buffer_store(magnetic_buffer_t *buffer, int32_t cell, const int16_t point[3], uint32_t time)
{
    const bool is_empty = buffer->stored[cell] == 0u, is_full = buffer->held == MAGNETIC_BUFFER_FULL;
    if (is_empty && is_full) {
        put(buffer, cell, point, time);
        free_oldest(buffer);
    } else if (is_empty) {
        put(buffer, cell, point, time);
        buffer->held++;
    } else if (is_full || is_near(buffer->points[cell], point)) {
        put(buffer, cell, point, time);
    } else {
        const int32_t spare = cell_to_spare(buffer, point);
        if (spare != MAGNETIC_BUFFER_NO_CELL) {
            put(buffer, spare, point, time);
            buffer->held++;
        }
    }
}

FAST_CODE uint16_t magnetic_buffer_gather(const magnetic_buffer_t *buffer, int32_t first, int32_t count, int16_t points[][3])
{
    uint16_t gathered = 0;
    for (int32_t cell = first; cell < first + count; cell++) {
        if (buffer->stored[cell] != 0u) {
            points[gathered][0] = buffer->points[cell][0];
            points[gathered][1] = buffer->points[cell][1];
            points[gathered][2] = buffer->points[cell][2];
            gathered++;
        }
    }
    return gathered;
}

FAST_CODE void magnetic_buffer_range(const magnetic_buffer_t *buffer, int16_t minimum[3], int16_t maximum[3])
{
    for (int axis = 0; axis < 3; axis++) {
        int16_t low = INT16_MAX, high = INT16_MIN;
        for (int32_t cell = 0; cell < MAGNETIC_BUFFER_CELLS; cell++) {
            if (buffer->stored[cell] != 0u) {
                const int16_t value = buffer->points[cell][axis];
                low = value < low ? value : low;
                high = value > high ? value : high;
            }
        }
        minimum[axis] = low;
        maximum[axis] = high;
    }
}
