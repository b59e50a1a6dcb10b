#include "sampler.h"

#include "boards/time_base.h"

sensor_status_t sampler_start(sampler_t *sampler, const sensor_t *sensor)
{
    *sampler = (sampler_t){.sensor = sensor};
    const sensor_status_t status = sensor_discard(sensor);
    sampler->next_look_us = time_us() + sensor->driver->period_us / 8u;
    return status;
}

sensor_status_t sampler_look(sampler_t *sampler, sample_t *sample)
{
    const uint32_t period_us = sampler->sensor->driver->period_us;
    const sensor_status_t status = sensor_read_if_ready(sampler->sensor, sample);
    if (status == SENSOR_OK) {
        sampler->next_look_us = sample->time_us + period_us - period_us / 16u;
        if (sample->overrun && sampler->overruns < UINT16_MAX) {
            sampler->overruns++;
        }
    } else {
        sampler->next_look_us = time_us() + period_us / 8u;
    }
    return status;
}

sensor_status_t sampler_next(sampler_t *sampler, sample_t *sample, uint64_t deadline_us)
{
    /* Each round moves next_look_us on by at least an eighth of a period, so the deadline bounds the rounds. */
    while (sampler->next_look_us < deadline_us) {
        sleep_until_us(sampler->next_look_us);
        const sensor_status_t status = sampler_look(sampler, sample);
        if (status != SENSOR_NOT_READY) {
            return status;
        }
    }
    return SENSOR_TIMED_OUT;
}
