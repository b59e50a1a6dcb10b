#include "sample_series.h"

#include "boards/time_base.h"
#include "sensor_set.h"

/** The series that must be looked at next; NULL when all have `count` samples. */
static series_t *next_series(series_t *series, size_t series_count, uint16_t count)
{
    series_t *next = NULL;
    for (size_t i = 0; i < series_count; i++) {
        const bool open = series[i].sampler.sensor != NULL && series[i].statistics.count < count;
        if (open && (next == NULL || series[i].sampler.next_look_us < next->sampler.next_look_us)) {
            next = &series[i];
        }
    }
    return next;
}

sensor_status_t series_fill(series_t *series, size_t series_count, uint16_t count, uint64_t deadline_us)
{
    for (size_t i = 0; i < series_count; i++) {
        if (series[i].sampler.sensor != NULL) {
            const sensor_status_t status = sampler_start(&series[i].sampler, series[i].sampler.sensor);
            if (status != SENSOR_OK) {
                return status;
            }
        }
    }
    series_t *next = next_series(series, series_count, count);
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
        next = next_series(series, series_count, count);
    }
    return SENSOR_OK;
}

status_t series_fill_selected(series_t series[SENSOR_KIND_COUNT], uint16_t count, uint64_t deadline_us)
{
    for (uint32_t kind = 0; kind < SENSOR_KIND_COUNT; kind++) {
        series[kind] = (series_t){.sampler = {.sensor = sensor_set_selected((sensor_kind_t)kind)}};
    }
    if (series[SENSOR_MAGNETOMETER].sampler.sensor == NULL || series[SENSOR_ACCELEROMETER].sampler.sensor == NULL) {
        return STATUS_SENSOR_ABSENT;
    }
    return status_of_sensor(series_fill(series, SENSOR_KIND_COUNT, count, deadline_us));
}

void write_statistics(payload_writer_t *reply, const vector_statistics_t *statistics)
{
    float values[3];
    statistics_mean(statistics, values);
    write_f32_array(reply, values, 3);
    statistics_spread(statistics, values);
    write_f32_array(reply, values, 3);
}

void write_series(payload_writer_t *reply, const series_t series[SENSOR_KIND_COUNT], uint16_t count)
{
    uint32_t overruns = 0;
    write_u16(reply, count);
    for (uint32_t kind = 0; kind < SENSOR_KIND_COUNT; kind++) {
        write_statistics(reply, &series[kind].statistics);
        overruns += series[kind].sampler.overruns;
    }
    write_u16(reply, (uint16_t)(overruns < UINT16_MAX ? overruns : UINT16_MAX));
}
