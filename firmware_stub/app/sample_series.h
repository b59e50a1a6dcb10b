/**
 * @file sample_series.h
 * @brief New samples of several sensors side by side, each at its own rate, until there are enough of each.
 */
#ifndef HILTEST_SAMPLE_SERIES_H
#define HILTEST_SAMPLE_SERIES_H

#include "protocol/message.h"
#include "protocol/payload.h"
#include "sensors/sampler.h"
#include "vector_statistics.h"

/** Samples of one sensor. */
typedef struct {
    sampler_t sampler;
    vector_statistics_t statistics;
} series_t;

/** The sensors of an attitude: the first kinds, SENSOR_MAGNETOMETER and SENSOR_ACCELEROMETER. */
#define ATTITUDE_KINDS 2u

/**
 * Take `count` new samples of the selected magnetometer and of the selected accelerometer.
 *
 * @param[out] series one of each kind, in the order of the kinds
 * @param deadline_us bounds the looks, each of which moves its series' next one on [us]
 * @return SENSOR_ABSENT when one of the two is not selected
 */
status_t series_fill(series_t series[ATTITUDE_KINDS], uint16_t count, uint64_t deadline_us);

/** Write mean and spread of one series. */
void write_statistics(payload_writer_t *reply, const vector_statistics_t *statistics);

/** Write the number of samples, mean and spread of both kinds, and the overruns of both together. */
void write_series(payload_writer_t *reply, const series_t series[ATTITUDE_KINDS], uint16_t count);

#endif
