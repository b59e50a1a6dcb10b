/**
 * @file fifo_sampler.h
 * @brief All samples of a sensor without a gap, taken out of its FIFO in bursts.
 *
 * A sample read by itself costs two I2C transactions, 15 bytes; in a burst of 16 it costs 6.4. The first and the last sample of a
 * series are looked for sixteen times a period, so the time between them is known to 0.3 ms at 200 Hz, whatever the
 * sensor's own clock does; those between are as far apart as it says.
 */
#ifndef HILTEST_FIFO_SAMPLER_H
#define HILTEST_FIFO_SAMPLER_H

#include "sensor.h"

/** Samples waited for before they are read: half of what the parts hold. */
#define FIFO_SAMPLER_BURST 16u

typedef struct {
    const sensor_t *sensor;
    uint64_t first_us;  /**< the first sample was found to be there [us] */
    uint64_t looked_us; /**< of the latest look: the last sample taken was there, and `held` others [us] */
    uint8_t held;       /**< samples that the latest look found and that were not taken yet */
    bool lost;          /**< the FIFO ran over: the series has a gap */
} fifo_sampler_t;

/** Turn the FIFO on, empty, and wait for its first sample. A sensor without one in its driver must not be given. */
sensor_status_t fifo_sampler_start(fifo_sampler_t *sampler, const sensor_t *sensor, uint64_t deadline_us);

/**
 * Wait for samples and take them.
 *
 * @param wanted how many the caller still wants, at least 1; when no more than a burst, the wait ends as the last one comes
 * @param[out] body at least SENSOR_FIFO_BURST of them
 * @param[out] count how many were taken, 1 to SENSOR_FIFO_BURST and at most `wanted`
 */
sensor_status_t fifo_sampler_take(fifo_sampler_t *sampler, uint32_t wanted, uint64_t deadline_us, int16_t body[][3],
                                  uint8_t *count);

/** Ask how many samples wait to be taken now; may be 0. */
sensor_status_t fifo_sampler_waiting(fifo_sampler_t *sampler, uint8_t *count);

/** Whether the FIFO is on since some fifo_sampler_start(). */
bool fifo_sampler_runs(const sensor_t *sensor);

/** Whether it is on since this sampler's start, and no other one has begun since: the series goes on. */
bool fifo_sampler_goes_on(const fifo_sampler_t *sampler, const sensor_t *sensor);

/** Forget that the FIFO is on: the sensor has been set up anew, or is about to be. */
void fifo_sampler_forget(const sensor_t *sensor);

#endif
