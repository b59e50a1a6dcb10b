#include "points_buffer.h"

#include <string.h>

#include "calibration/point_range.h"

static struct {
    _Alignas(4) int16_t magnetometer[POINTS_MAXIMUM][3]; /* aligned: calibrators may load two coordinates at once */
    int16_t accelerometer[POINTS_MAXIMUM][3];
    point_range_t range[POINTS_MAXIMUM]; /* of all points up to this one */
    uint16_t count;
} buffer;

void points_clear(void)
{
    buffer.count = 0;
}

uint16_t points_count(void)
{
    return buffer.count;
}

bool points_store(const int16_t magnetometer[3], const int16_t accelerometer[3])
{
    const uint16_t index = buffer.count;
    if (index >= POINTS_MAXIMUM) {
        return false;
    }
    const point_range_t *const before = &buffer.range[index == 0u ? 0u : index - 1u];
#pragma GCC unroll 3
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const int16_t value = magnetometer[axis];
        const int16_t lowest = index == 0u ? value : before->minimum[axis], highest = index == 0u ? value : before->maximum[axis];
        buffer.magnetometer[index][axis] = value;
        buffer.accelerometer[index][axis] = accelerometer[axis];
        buffer.range[index].minimum[axis] = value < lowest ? value : lowest;
        buffer.range[index].maximum[axis] = value > highest ? value : highest;
    }
    buffer.count = (uint16_t)(index + 1u);
    return true;
}

magnetometer_points_t points_first(uint16_t count)
{
    magnetometer_points_t points = {.points = (const int16_t(*)[3])buffer.magnetometer, .count = count};
    memcpy(points.minimum, buffer.range[count - 1u].minimum, sizeof points.minimum);
    memcpy(points.maximum, buffer.range[count - 1u].maximum, sizeof points.maximum);
    return points;
}

dpi_pairs_t pairs_first(uint16_t count)
{
    dpi_pairs_t pairs = {
        .magnetometer = (const int16_t(*)[3])buffer.magnetometer,
        .accelerometer = (const int16_t(*)[3])buffer.accelerometer,
        .count = count,
    };
    memcpy(pairs.minimum, buffer.range[count - 1u].minimum, sizeof pairs.minimum);
    memcpy(pairs.maximum, buffer.range[count - 1u].maximum, sizeof pairs.maximum);
    return pairs;
}

const int16_t *points_magnetometer(uint16_t index)
{
    return buffer.magnetometer[index];
}

const int16_t *points_accelerometer(uint16_t index)
{
    return buffer.accelerometer[index];
}
