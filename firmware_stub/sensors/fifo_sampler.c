#include "fifo_sampler.h"

#include <stddef.h>

#include "boards/time_base.h"

#define LOOKS_A_PERIOD 16u

/** The one sensor whose FIFO is on, NULL when none is; and the sampler that turned it on, to be compared and nothing else. */
static const sensor_t *running;
static const fifo_sampler_t *owner;

bool fifo_sampler_runs(const sensor_t *sensor)
{
    return running == sensor;
}

bool fifo_sampler_goes_on(const fifo_sampler_t *sampler, const sensor_t *sensor)
{
    return running == sensor && owner == sampler && sampler->sensor == sensor;
}

void fifo_sampler_forget(const sensor_t *sensor)
{
    running = running == sensor ? NULL : running;
}

static sensor_status_t look(fifo_sampler_t *sampler)
{
    bool lost = false;
    sampler->looked_us = time_us();
    const sensor_status_t status = sensor_fifo_look(sampler->sensor, &sampler->held, &lost);
    sampler->lost = sampler->lost || lost;
    return status;
}

/** Look again and again from `from_us` on until `count` samples are there. Bounded: every look comes later. */
static sensor_status_t look_until(fifo_sampler_t *sampler, uint8_t count, uint64_t from_us, uint64_t deadline_us)
{
    const uint32_t step_us = sampler->sensor->driver->period_us / LOOKS_A_PERIOD;
    uint64_t next_us = from_us;
    while (next_us < deadline_us) {
        sleep_until_us(next_us);
        const sensor_status_t status = look(sampler);
        if (status != SENSOR_OK || sampler->held >= count) {
            return status;
        }
        next_us = sampler->looked_us + step_us;
    }
    return SENSOR_TIMED_OUT;
}

sensor_status_t fifo_sampler_start(fifo_sampler_t *sampler, const sensor_t *sensor, uint64_t deadline_us)
{
    *sampler = (fifo_sampler_t){.sensor = sensor};
    running = sensor;
    owner = sampler;
    sensor_status_t status = sensor_configure_fifo(sensor);
    if (status == SENSOR_OK) {
        status = look_until(sampler, 1, time_us() + sensor->driver->fifo.start_up_us, deadline_us);
    }
    sampler->first_us = sampler->looked_us;
    return status;
}

sensor_status_t fifo_sampler_waiting(fifo_sampler_t *sampler, uint8_t *count)
{
    const sensor_status_t status = look(sampler);
    *count = sampler->held;
    return status;
}

/** When to look first so that `missing` samples can be there and hardly more: a sixteenth early, as far as clocks may differ. */
static uint64_t first_look_us(const fifo_sampler_t *sampler, uint8_t missing)
{
    const uint32_t wait_us = (missing - 1u) * sampler->sensor->driver->period_us;
    return sampler->looked_us + wait_us - wait_us / 16u;
}

sensor_status_t fifo_sampler_take(fifo_sampler_t *sampler, uint32_t wanted, uint64_t deadline_us, int16_t body[][3],
                                  uint8_t *count)
{
    const bool is_last = wanted <= FIFO_SAMPLER_BURST;
    const uint8_t needed = is_last ? (uint8_t)wanted : FIFO_SAMPLER_BURST;
    sensor_status_t status = SENSOR_OK;
    if (sampler->held < needed) {
        const uint8_t missing = (uint8_t)(needed - sampler->held);
        const uint64_t all_us = sampler->looked_us + missing * sampler->sensor->driver->period_us;
        /* In the middle of a series one look is enough: what comes a little later is in the next burst. */
        status = look_until(sampler, is_last ? needed : 1u, is_last ? first_look_us(sampler, missing) : all_us, deadline_us);
    }
    const uint32_t most = wanted < SENSOR_FIFO_BURST ? wanted : SENSOR_FIFO_BURST;
    *count = (uint8_t)(sampler->held < most ? sampler->held : most);
    if (status == SENSOR_OK) {
        status = sensor_fifo_read(sampler->sensor, body, *count);
        sampler->held = (uint8_t)(sampler->held - *count);
    }
    return status;
}
