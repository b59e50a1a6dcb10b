#include "axes.h"

static int16_t limited(int16_t value)
{
    return value == INT16_MIN ? (int16_t)(INT16_MIN + 1) : value;
}

static int16_t negated(int16_t value)
{
    return (int16_t)-limited(value);
}

void axes_accelerometer(const int16_t sensor[3], int16_t body[3])
{
    body[0] = limited(sensor[1]);
    body[1] = limited(sensor[0]);
    body[2] = limited(sensor[2]);
}

void axes_fxos8700_magnetometer(const int16_t sensor[3], int16_t body[3])
{
    body[0] = negated(sensor[1]);
    body[1] = negated(sensor[0]);
    body[2] = negated(sensor[2]);
}

void axes_mag3110(const int16_t sensor[3], int16_t body[3])
{
    body[0] = negated(sensor[1]);
    body[1] = negated(sensor[0]);
    body[2] = limited(sensor[2]);
}

void axes_gyroscope(const int16_t sensor[3], int16_t body[3])
{
    body[0] = negated(sensor[1]);
    body[1] = negated(sensor[0]);
    body[2] = negated(sensor[2]);
}
