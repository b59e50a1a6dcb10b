#include "pair_collector.h"

#include "boards/time_base.h"
#include "points_buffer.h"

/** A reading, and the times between which it became ready. */
typedef struct {
    int16_t body[3];
    uint64_t earliest_us, latest_us;
} reading_t;

typedef struct {
    sampler_t magnetometer, accelerometer;
    reading_t before, after; /**< the accelerometer's last two */
    reading_t point;         /**< of the magnetometer, waiting for the acceleration behind it */
    bool is_waiting;
} collector_t;

static reading_t reading_of(const sampler_t *sampler, const sample_t *sample)
{
    return (reading_t){
        .body = {sample->body[0], sample->body[1], sample->body[2]},
        .earliest_us = sampler->earliest_us,
        .latest_us = sampler->latest_us,
    };
}

static int64_t twice_the_middle_us(const reading_t *reading)
{
    return (int64_t)(reading->earliest_us + reading->latest_us);
}

/** Store the point, with the acceleration from the line between the two readings around it. */
static void store_pair(collector_t *collector)
{
    const reading_t *const before = &collector->before, *const after = &collector->after;
    const int64_t span = twice_the_middle_us(after) - twice_the_middle_us(before);
    const int64_t passed = twice_the_middle_us(&collector->point) - twice_the_middle_us(before);
    const int64_t gone = passed > 0 ? passed : 0; /* bounds may move while they narrow */
    int16_t acceleration[3];
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const int32_t step = after->body[axis] - before->body[axis];
        const int64_t part = gone < span ? step * gone / span : step;
        acceleration[axis] = (int16_t)(before->body[axis] + part);
    }
    (void)points_store(collector->point.body, acceleration); /* there is room */
    collector->is_waiting = false;
}

/** Look at the sensor whose turn it is; a point that waits has no use for another. */
static sensor_status_t look(collector_t *collector)
{
    sampler_t *const magnetometer = &collector->magnetometer;
    sampler_t *const accelerometer = &collector->accelerometer;
    const bool is_points_turn = !collector->is_waiting && magnetometer->next_look_us <= accelerometer->next_look_us;
    sampler_t *const next = is_points_turn ? magnetometer : accelerometer;
    sample_t sample;
    sleep_until_us(next->next_look_us);
    const sensor_status_t status = sampler_look(next, &sample);
    if (status == SENSOR_OK && is_points_turn) {
        collector->point = reading_of(magnetometer, &sample);
        collector->is_waiting = true;
    } else if (status == SENSOR_OK) {
        collector->before = collector->after;
        collector->after = reading_of(accelerometer, &sample);
    }
    return status == SENSOR_NOT_READY ? SENSOR_OK : status;
}

/** Begin with two readings of the accelerometer: whatever point comes, one of them is before it. */
static sensor_status_t begin(collector_t *collector, const sensor_t *accelerometer, uint64_t deadline_us)
{
    sample_t sample;
    sensor_status_t status = sampler_start(&collector->accelerometer, accelerometer);
    for (uint32_t i = 0; i < 2u && status == SENSOR_OK; i++) {
        status = sampler_next(&collector->accelerometer, &sample, deadline_us);
        if (status == SENSOR_OK) {
            collector->before = collector->after;
            collector->after = reading_of(&collector->accelerometer, &sample);
        }
    }
    return status;
}

sensor_status_t collect_pairs(const sensor_t *magnetometer, const sensor_t *accelerometer, uint16_t count,
                              uint64_t deadline_us, uint16_t *overruns)
{
    collector_t collector = {0};
    uint16_t stored = 0;
    sensor_status_t status = begin(&collector, accelerometer, deadline_us);
    if (status == SENSOR_OK) {
        status = sampler_start(&collector.magnetometer, magnetometer);
    }
    /* Each look moves the sensor's next one on by at least an eighth of a period, so the deadline bounds them. */
    while (status == SENSOR_OK && stored < count) {
        if (collector.accelerometer.next_look_us >= deadline_us || collector.magnetometer.next_look_us >= deadline_us) {
            return SENSOR_TIMED_OUT;
        }
        status = look(&collector);
        /* Surely behind it. Were it only likely, two instants that are the same would end a run now or 5 ms later, by chance. */
        if (collector.is_waiting && collector.after.earliest_us >= collector.point.latest_us) {
            store_pair(&collector);
            stored++;
        }
    }
    *overruns = collector.magnetometer.overruns;
    return status;
}
