#include "points_buffer.h"

#include <string.h>

static struct {
    _Alignas(4) int16_t magnetometer[POINTS_MAXIMUM][3]; /* aligned: calibrators may load two coordinates at once */
    int16_t accelerometer[POINTS_MAXIMUM][3];
    int16_t minimum[POINTS_MAXIMUM][3]; /* of all points up to this one */
    int16_t maximum[POINTS_MAXIMUM][3];
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
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const int16_t value = magnetometer[axis];
        const int16_t low = index == 0u ? value : buffer.minimum[index - 1u][axis];
        const int16_t high = index == 0u ? value : buffer.maximum[index - 1u][axis];
        buffer.magnetometer[index][axis] = value;
        buffer.accelerometer[index][axis] = accelerometer[axis];
        buffer.minimum[index][axis] = value < low ? value : low;
        buffer.maximum[index][axis] = value > high ? value : high;
    }
    buffer.count++;
    return true;
}

magnetometer_points_t points_first(uint16_t count)
{
    magnetometer_points_t points = {.points = (const int16_t(*)[3])buffer.magnetometer, .count = count};
    memcpy(points.minimum, buffer.minimum[count - 1u], sizeof points.minimum);
    memcpy(points.maximum, buffer.maximum[count - 1u], sizeof points.maximum);
    return points;
}

dpi_pairs_t pairs_first(uint16_t count)
{
    dpi_pairs_t pairs = {
        .magnetometer = (const int16_t(*)[3])buffer.magnetometer,
        .accelerometer = (const int16_t(*)[3])buffer.accelerometer,
        .count = count,
    };
    memcpy(pairs.minimum, buffer.minimum[count - 1u], sizeof pairs.minimum);
    memcpy(pairs.maximum, buffer.maximum[count - 1u], sizeof pairs.maximum);
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
