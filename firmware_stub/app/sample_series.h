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
    sampler_t sampler; /**< its sensor is NULL when no sensor of the kind is selected: it then stays empty */
    vector_statistics_t statistics;
} series_t;

/** Take `count` new samples of every sensor. Bounded by the deadline [us]: every look moves its next one on. */
sensor_status_t series_fill(series_t *series, size_t series_count, uint16_t count, uint64_t deadline_us);

/**
 * Take `count` new samples of the selected sensor of each kind.
 *
 * @param[out] series one of each kind, in the order of the kinds
 * @return SENSOR_ABSENT when no magnetometer or no accelerometer is selected; the gyroscope may be missing
 */
status_t series_fill_selected(series_t series[SENSOR_KIND_COUNT], uint16_t count, uint64_t deadline_us);

/** Write mean and spread of one series. */
void write_statistics(payload_writer_t *reply, const vector_statistics_t *statistics);

/** Write the number of samples, mean and spread of each kind, and the overruns of all together. */
void write_series(payload_writer_t *reply, const series_t series[SENSOR_KIND_COUNT], uint16_t count);

#endif
