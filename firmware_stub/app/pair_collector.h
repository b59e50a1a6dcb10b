/**
 * @file pair_collector.h
 * @brief Points of the magnetometer, each with the acceleration at its own instant.
 *
 * The parts sample by clocks of their own. An accelerometer sample that is up to a period old is, at 500 deg/s, up to 2.5 degrees off,
 * always the same way: a calibration against gravity would turn by the mean of it. So both are sampled side by side, and the
 * acceleration is taken from the line between its samples before and after the magnetometer's.
 */
#ifndef HILTEST_PAIR_COLLECTOR_H
#define HILTEST_PAIR_COLLECTOR_H

#include "sensors/sampler.h"

/**
 * Store `count` new points in the points buffer, which must have room for them.
 *
 * @param deadline_us when it runs out, the points that came stay [us]
 * @param[out] overruns samples of the magnetometer before which others were lost
 */
sensor_status_t collect_pairs(const sensor_t *magnetometer, const sensor_t *accelerometer, uint16_t count,
                              uint64_t deadline_us, uint16_t *overruns);

#endif
