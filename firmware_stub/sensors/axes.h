/**
 * @file axes.h
 * @brief From a sensor's own axes, as it sits on the FRDM-FXS-MULTI-B shield, to the board's body frame.
 *
 * Body frame: x forward, y right, z down. Everything above the drivers is in it. -32768 becomes -32767 first, so that a negated
 * value always exists. The on-board FXOS8700CQ uses the same map; no public source confirms its mounting.
 */
#ifndef HILTEST_AXES_H
#define HILTEST_AXES_H

#include <stdint.h>

typedef void (*axis_map_t)(const int16_t sensor[3], int16_t body[3]);

/** Accelerometer: (y, x, z), gravity-positive; a level board reads (0, 0, +1 g). */
void axes_accelerometer(const int16_t sensor[3], int16_t body[3]);

/** Magnetometer of the FXOS8700CQ: (-y, -x, -z). */
void axes_fxos8700_magnetometer(const int16_t sensor[3], int16_t body[3]);

/** MAG3110: (-y, -x, +z); its z points against the FXOS8700CQ's. */
void axes_mag3110(const int16_t sensor[3], int16_t body[3]);

/** Gyroscope: (-y, -x, -z). */
void axes_gyroscope(const int16_t sensor[3], int16_t body[3]);

#endif
