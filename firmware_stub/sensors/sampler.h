/**
 * @file sampler.h
 * @brief New samples of a sensor, each exactly once, without looking for them all the time.
 *
 * The status of a sensor costs an I2C transaction of 0.1 ms. So after a sample the sampler sleeps for 15/16 of the period and then
 * looks every 1/8 of a period until the next is there. The look drifts towards the moment of data-ready from behind and holds
 * there, also when the sensor's clock is up to 6 % fast.
 */
#ifndef HILTEST_SAMPLER_H
#define HILTEST_SAMPLER_H

#include "sensor.h"

typedef struct {
    const sensor_t *sensor;
    uint64_t next_look_us;
    uint16_t overruns; /**< samples before which others were lost */
} sampler_t;

/** Begin: drop what the sensor holds, so that everything sampled is new. */
sensor_status_t sampler_start(sampler_t *sampler, const sensor_t *sensor);

/** Look once. SENSOR_OK with a sample, SENSOR_NOT_READY, or what went wrong; sets when to look next. */
sensor_status_t sampler_look(sampler_t *sampler, sample_t *sample);

/** Sleep and look until a sample comes; SENSOR_TIMED_OUT at the deadline [us]. */
sensor_status_t sampler_next(sampler_t *sampler, sample_t *sample, uint64_t deadline_us);

#endif
