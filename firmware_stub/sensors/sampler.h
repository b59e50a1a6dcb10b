/**
 * @file sampler.h
 * @brief New samples of a sensor, each exactly once, without looking for them all the time.
 *
 * A look at the status costs an I2C transaction of 0.1 ms, so the sampler sleeps until a sample should be there. It looks a little
 * less than a period after the look that found the last one, so looks move towards the moment of data-ready from behind. A look
 * that comes too early is repeated an eighth of a period later, which happens once in eight samples when the sensor's clock is
 * right. When it does not happen the sensor is faster than it says, and the looks move twice as fast.
 *
 * A look says that a sample was there, not since when. But samples come a period apart, so every look that finds one, and every one
 * that comes too early, bounds the instants of all: after some ten samples to a 64th of a period.
 */
#ifndef HILTEST_SAMPLER_H
#define HILTEST_SAMPLER_H

#include "sensor.h"

typedef struct {
    const sensor_t *sensor;
    uint64_t next_look_us;
    uint8_t hits;      /**< looks in a row that found a sample */
    uint16_t overruns; /**< samples before which others were lost */
    uint64_t missed_us;   /**< the last look that found nothing */
    uint64_t earliest_us; /**< between these two the last sample became ready */
    uint64_t latest_us;
} sampler_t;

/** Begin: drop what the sensor holds, so that everything sampled is new. */
sensor_status_t sampler_start(sampler_t *sampler, const sensor_t *sensor);

/** Look once. SENSOR_OK with a sample, SENSOR_NOT_READY, or what went wrong; sets when to look next. */
sensor_status_t sampler_look(sampler_t *sampler, sample_t *sample);

/** Sleep and look until a sample comes; SENSOR_TIMED_OUT at the deadline [us]. */
sensor_status_t sampler_next(sampler_t *sampler, sample_t *sample, uint64_t deadline_us);

#endif
