/**
 * @file points_buffer.h
 * @brief The points that calibrators run on, in the order they came.
 *
 * The range of the first n points is exact for every n, without a pass over them: it is kept with each point as it is stored, so
 * a calibrator gets it for nothing, as firmware that calibrates while it collects would.
 */
#ifndef HILTEST_POINTS_BUFFER_H
#define HILTEST_POINTS_BUFFER_H

#include <stdbool.h>
#include <stdint.h>

#include "calibration/dpi.h"
#include "calibration/magnetometer_calibrator.h"

#define POINTS_MAXIMUM 512u

void points_clear(void);

uint16_t points_count(void);

/** Store a magnetometer point and the accelerometer sample taken with it [counts, body frame]. False when the buffer is full. */
bool points_store(const int16_t magnetometer[3], const int16_t accelerometer[3]);

/** The first `count` points and their range; `count` from 1 to points_count(). */
magnetometer_points_t points_first(uint16_t count);

/** The first `count` points with their accelerometer samples; `count` from 1 to points_count(). */
dpi_pairs_t pairs_first(uint16_t count);

/** Magnetometer part of a stored point. */
const int16_t *points_magnetometer(uint16_t index);

/** Accelerometer part of a stored point. */
const int16_t *points_accelerometer(uint16_t index);

#endif
