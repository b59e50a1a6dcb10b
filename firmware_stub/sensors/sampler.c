#include "sampler.h"

#include "boards/time_base.h"
#include "fifo_sampler.h"

#define RETRIES_A_SAMPLE 8u

sensor_status_t sampler_start(sampler_t *sampler, const sensor_t *sensor)
{
    *sampler = (sampler_t){.sensor = sensor};
    sensor_status_t status = SENSOR_OK;
    uint32_t pause_us = sensor->driver->period_us / RETRIES_A_SAMPLE;
    if (fifo_sampler_runs(sensor)) {
        fifo_sampler_forget(sensor);
        status = sensor_configure(sensor);
        pause_us = sensor->driver->fifo.start_up_us;
    }
    if (status == SENSOR_OK) {
        sampler->missed_us = sampler->earliest_us = time_us(); /* and latest_us is 0: no bounds but this one */
        status = sensor_discard(sensor);
    }
    sampler->next_look_us = time_us() + pause_us;
    return status;
}

/** How much earlier than a period the next look comes: 1/64, twice that after every 8 hits in a row, at most 1/8. */
static uint32_t lead_us(uint32_t period_us, uint8_t hits)
{
    const uint32_t doublings = hits / RETRIES_A_SAMPLE;
    return period_us / 64u << (doublings < 3u ? doublings : 3u);
}

/** The instant of a sample that was ready when the sensor was polled at now_us. */
static void bound_instant(sampler_t *sampler, uint64_t now_us, bool overrun)
{
    const uint32_t period_us = sampler->sensor->driver->period_us;
    const uint64_t earliest_us = sampler->earliest_us + period_us, latest_us = sampler->latest_us + period_us;
    sampler->earliest_us = earliest_us > sampler->missed_us ? earliest_us : sampler->missed_us;
    sampler->latest_us = latest_us < now_us ? latest_us : now_us;
    /* Nothing is left of bounds from a clock that is not what the part says, nor from before samples were lost: this look alone. */
    if (overrun || sampler->earliest_us > sampler->latest_us) {
        sampler->earliest_us = now_us - sampler->missed_us < period_us ? sampler->missed_us : now_us - period_us;
        sampler->latest_us = now_us;
    }
}

sensor_status_t sampler_look(sampler_t *sampler, sample_t *sample)
{
    const uint32_t period_us = sampler->sensor->driver->period_us;
    const uint64_t now_us = time_us();
    const sensor_status_t status = sensor_read_if_ready(sampler->sensor, sample);
    if (status != SENSOR_OK) {
        sampler->next_look_us = now_us + period_us / RETRIES_A_SAMPLE;
        sampler->hits = 0;
        sampler->missed_us = now_us;
        return status;
    }
    bound_instant(sampler, now_us, sample->overrun);
    sample->time_us = now_us;
    sampler->next_look_us = now_us + period_us - lead_us(period_us, sampler->hits);
    if (sampler->hits < UINT8_MAX) {
        sampler->hits++;
    }
    if (sample->overrun && sampler->overruns < UINT16_MAX) {
        sampler->overruns++;
    }
    return SENSOR_OK;
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
