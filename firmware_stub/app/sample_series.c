#include "sample_series.h"

#include "boards/time_base.h"
#include "sensor_set.h"

/** The series that must be looked at next; NULL when both have `count` samples. */
static series_t *next_series(series_t series[ATTITUDE_KINDS], uint16_t count)
{
    series_t *next = NULL;
    for (size_t kind = 0; kind < ATTITUDE_KINDS; kind++) {
        const bool open = series[kind].statistics.count < count;
        if (open && (next == NULL || series[kind].sampler.next_look_us < next->sampler.next_look_us)) {
            next = &series[kind];
        }
    }
    return next;
}

static sensor_status_t take_samples(series_t series[ATTITUDE_KINDS], uint16_t count, uint64_t deadline_us)
{
    series_t *next = next_series(series, count);
    while (next != NULL) {
        if (next->sampler.next_look_us >= deadline_us) {
            return SENSOR_TIMED_OUT;
        }
        sleep_until_us(next->sampler.next_look_us);
        sample_t sample;
        const sensor_status_t status = sampler_look(&next->sampler, &sample);
        if (status == SENSOR_OK) {
            statistics_add(&next->statistics, sample.body);
        } else if (status != SENSOR_NOT_READY) {
            return status;
        }
        next = next_series(series, count);
    }
    return SENSOR_OK;
}

status_t series_fill(series_t series[ATTITUDE_KINDS], uint16_t count, uint64_t deadline_us)
{
    sensor_status_t status = SENSOR_OK;
    for (uint32_t kind = 0; kind < ATTITUDE_KINDS && status == SENSOR_OK; kind++) {
        const sensor_t *sensor = sensor_set_selected((sensor_kind_t)kind);
        series[kind] = (series_t){.statistics = {.count = 0}};
        status = sensor == NULL ? SENSOR_ABSENT : sampler_start(&series[kind].sampler, sensor);
    }
    if (status == SENSOR_OK) {
        status = take_samples(series, count, deadline_us);
    }
    return status_of_sensor(status);
}

void write_statistics(payload_writer_t *reply, const vector_statistics_t *statistics)
{
    float values[3];
    statistics_mean(statistics, values);
    write_f32_array(reply, values, 3);
    statistics_spread(statistics, values);
    write_f32_array(reply, values, 3);
}

void write_series(payload_writer_t *reply, const series_t series[ATTITUDE_KINDS], uint16_t count)
{
    uint32_t overruns = 0;
    write_u16(reply, count);
    for (uint32_t kind = 0; kind < ATTITUDE_KINDS; kind++) {
        write_statistics(reply, &series[kind].statistics);
        overruns += series[kind].sampler.overruns;
    }
    write_u16(reply, (uint16_t)(overruns < UINT16_MAX ? overruns : UINT16_MAX));
}
