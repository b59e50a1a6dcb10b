#include "fusion_run.h"

#include "boards/time_base.h"
#include "calibration_slots.h"
#include "gyroscope_calibration.h"
#include "orientation/triad.h"
#include "sensor_set.h"
#include "sensors/sampler.h"
#include "vector_statistics.h"

#define RADIANS_PER_DEGREE 0.017453293f
#define QUATERNION_SCALE 32767.0f
#define SECONDS_PER_US 1.0e-6f

static const float no_rate_rad_s[3];

/* The settings of a run, and its records. */
static struct {
    bool started;
    fusion_settings_t settings;
    attitude_filter_t first;
    uint16_t count;
    fusion_record_t records[FUSION_RECORDS_MAXIMUM];
} kept;

/* The state of one run. */
typedef struct {
    sampler_t gyroscope;
    sampler_t magnetometer;
    const sensor_t *accelerometer;
    attitude_filter_t fused;
    attitude_filter_t turned;
    float rate_rad_s[3]; /* the latest */
    bool rate_known;
    uint64_t at_us; /* of the attitudes */
    uint32_t updates;
    fusion_summary_t *summary;
} run_t;

const fusion_record_t *fusion_record(uint16_t index)
{
    return &kept.records[index];
}

uint16_t fusion_record_count(void)
{
    return kept.count;
}

static void to_floats(const int16_t counts[3], float values[3])
{
    for (uint32_t axis = 0; axis < 3u; axis++) {
        values[axis] = counts[axis];
    }
}

/** Gravity [g] and unit field of counts under the slot's two calibrations; its magnetometer's is there. */
static void calibrated(const float acceleration[3], const float magnetic[3], float gravity_g[3], float field[3])
{
    accelerometer_apply(slot_accelerometer(kept.settings.slot), acceleration, gravity_g);
    calibration_apply(slot_get(kept.settings.slot), magnetic, field);
}

/** Means of the magnetometer's samples and of the accelerometer's latest at each. */
static sensor_status_t mean_at_rest(const sensor_t *magnetometer, uint64_t deadline_us, float acceleration[3],
                                    float magnetic[3])
{
    const sensor_t *accelerometer = sensor_set_selected(SENSOR_ACCELEROMETER);
    vector_statistics_t gravities = {0};
    vector_statistics_t fields = {0};
    sampler_t sampler;
    sensor_status_t status = sampler_start(&sampler, magnetometer);
    for (uint16_t i = 0; i < kept.settings.readings && status == SENSOR_OK; i++) {
        sample_t sample;
        int16_t gravity[3];
        status = sampler_next(&sampler, &sample, deadline_us);
        if (status == SENSOR_OK) {
            status = sensor_read_latest(accelerometer, gravity);
        }
        if (status == SENSOR_OK) {
            statistics_add(&fields, sample.body);
            statistics_add(&gravities, gravity);
        }
    }
    statistics_mean(&gravities, acceleration);
    statistics_mean(&fields, magnetic);
    return status;
}

status_t fusion_run_start(const fusion_settings_t *settings, uint64_t deadline_us, float attitude[4])
{
    kept.started = false;
    kept.count = 0;
    kept.settings = *settings;
    const sensor_t *gyroscope = sensor_set_selected(SENSOR_GYROSCOPE);
    const sensor_t *magnetometer = sensor_set_selected(SENSOR_MAGNETOMETER);
    if (sensor_set_selected(SENSOR_ACCELEROMETER) == NULL || magnetometer == NULL || gyroscope == NULL) {
        return STATUS_SENSOR_ABSENT;
    }
    if (slot_get(settings->slot) == NULL) {
        return STATUS_NO_CALIBRATION;
    }
    sampler_t woken; /* a gyroscope that has to be set up again is silent for 60 ms: now, not when the board moves */
    float acceleration[3], magnetic[3], gravity_g[3], field[3];
    sensor_status_t status = sampler_start(&woken, gyroscope);
    if (status == SENSOR_OK) {
        status = mean_at_rest(magnetometer, deadline_us, acceleration, magnetic);
    }
    if (status != SENSOR_OK) {
        return status_of_sensor(status);
    }
    calibrated(acceleration, magnetic, gravity_g, field);
    /* The bias is that of gyroscope_rate(). The mean counts for the time of its samples. */
    const uint32_t rest_us = settings->readings * magnetometer->driver->period_us;
    attitude_filter_init(&kept.first, no_rate_rad_s);
    (void)attitude_filter_turn(&kept.first, no_rate_rad_s, SECONDS_PER_US * (float)rest_us);
    if (attitude_filter_correct(&kept.first, gravity_g, field) != ATTITUDE_FILTER_OK) {
        return STATUS_DEGENERATE_FIELD;
    }
    attitude_filter_attitude(&kept.first, attitude);
    kept.started = true;
    return STATUS_OK;
}

/** Seconds from the moment of the attitudes to another one, which becomes theirs. */
static float seconds_until(run_t *run, uint64_t now_us)
{
    const float dt_s = SECONDS_PER_US * (float)(uint32_t)(now_us - run->at_us);
    run->at_us = now_us;
    return dt_s;
}

/** Count a step that was not, or not wholly, taken. */
static void count_omission(fusion_summary_t *summary, attitude_filter_status_t status)
{
    switch (status) {
    case ATTITUDE_FILTER_NO_ATTITUDE:
        summary->no_attitude++;
        break;
    case ATTITUDE_FILTER_FIELD_LEFT_OUT:
        summary->field_left_out++;
        break;
    case ATTITUDE_FILTER_BAD_STEP:
        summary->bad_steps++;
        break;
    case ATTITUDE_FILTER_OK:
        break;
    }
}

/** A new rate: from the last one to this, their mean. Half a period of an old rate would be an angle that comes late. */
static void take_rate(run_t *run, const sample_t *sample)
{
    float counts[3], rate_dps[3], mean_rad_s[3];
    to_floats(sample->body, counts);
    gyroscope_rate(gyroscope_calibration(), counts, rate_dps);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float rate_rad_s = RADIANS_PER_DEGREE * rate_dps[axis];
        mean_rad_s[axis] = run->rate_known ? 0.5f * (run->rate_rad_s[axis] + rate_rad_s) : rate_rad_s;
        run->rate_rad_s[axis] = rate_rad_s;
    }
    run->rate_known = true;
    const float dt_s = seconds_until(run, sample->time_us);
    count_omission(run->summary, attitude_filter_turn(&run->fused, mean_rad_s, dt_s));
    (void)attitude_filter_turn(&run->turned, mean_rad_s, dt_s);
}

static void store(int16_t stored[4], const float attitude[4])
{
    for (uint32_t i = 0; i < 4u; i++) {
        stored[i] = (int16_t)__builtin_lrintf(QUATERNION_SCALE * attitude[i]);
    }
}

static void keep(const run_t *run, const float measured[4])
{
    fusion_record_t *record = &kept.records[kept.count];
    record->time_us = (uint32_t)(run->at_us - run->summary->began_us);
    store(record->fused, run->fused.attitude);
    store(record->measured, measured);
    store(record->turned, run->turned.attitude);
    kept.count++;
}

/** A new field, with the accelerometer's latest: update by the latest rate, and keep one in so many. */
static sensor_status_t take_field(run_t *run, const sample_t *sample)
{
    int16_t latest[3];
    const sensor_status_t status = sensor_read_latest(run->accelerometer, latest);
    if (status != SENSOR_OK) {
        return status;
    }
    float acceleration[3], magnetic[3], gravity_g[3], field[3];
    to_floats(latest, acceleration);
    to_floats(sample->body, magnetic);
    calibrated(acceleration, magnetic, gravity_g, field);
    const float dt_s = seconds_until(run, sample->time_us);
    count_omission(run->summary,
                   timed_update(&run->summary->costs, &run->fused, run->rate_rad_s, gravity_g, field, dt_s));
    (void)attitude_filter_turn(&run->turned, run->rate_rad_s, dt_s);
    if (run->updates++ % kept.settings.every == 0u) {
        float measured[4] = {0};
        (void)triad(gravity_g, field, measured);
        keep(run, measured);
    }
    return SENSOR_OK;
}

static sensor_status_t begin(run_t *run)
{
    sensor_status_t status = sampler_start(&run->gyroscope, run->gyroscope.sensor);
    if (status == SENSOR_OK) {
        status = sampler_start(&run->magnetometer, run->magnetometer.sensor);
    }
    run->fused = run->turned = kept.first;
    kept.count = 0;
    run->summary->began_us = run->at_us = time_us();
    return status;
}

/** Look at the sensor whose turn it is. Bounded: every look moves its next one on. */
static sensor_status_t look(run_t *run)
{
    const bool rate_first = run->gyroscope.next_look_us <= run->magnetometer.next_look_us;
    sampler_t *sampler = rate_first ? &run->gyroscope : &run->magnetometer;
    sample_t sample;
    sleep_until_us(sampler->next_look_us);
    const sensor_status_t status = sampler_look(sampler, &sample);
    if (status != SENSOR_OK) {
        return status == SENSOR_NOT_READY ? SENSOR_OK : status;
    }
    if (rate_first) {
        take_rate(run, &sample);
        return SENSOR_OK;
    }
    return take_field(run, &sample);
}

status_t fusion_run(uint64_t until_us, fusion_summary_t *summary)
{
    run_t run = {
        .gyroscope.sensor = sensor_set_selected(SENSOR_GYROSCOPE),
        .magnetometer.sensor = sensor_set_selected(SENSOR_MAGNETOMETER),
        .accelerometer = sensor_set_selected(SENSOR_ACCELEROMETER),
        .summary = summary,
    };
    if (!kept.started || slot_get(kept.settings.slot) == NULL) {
        return STATUS_NO_CALIBRATION;
    }
    if (run.gyroscope.sensor == NULL || run.magnetometer.sensor == NULL || run.accelerometer == NULL) {
        return STATUS_SENSOR_ABSENT;
    }
    sensor_status_t status = begin(&run);
    while (status == SENSOR_OK && kept.count < FUSION_RECORDS_MAXIMUM && time_us() < until_us) {
        status = look(&run);
    }
    if (status == SENSOR_OK && (!run.rate_known || kept.count == 0u)) {
        status = SENSOR_TIMED_OUT;
    }
    const uint32_t overruns = (uint32_t)run.gyroscope.overruns + run.magnetometer.overruns;
    summary->overruns = (uint16_t)(overruns < UINT16_MAX ? overruns : UINT16_MAX);
    summary->records = kept.count;
    return status_of_sensor(status);
}
