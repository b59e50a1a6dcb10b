#include "fusion_run.h"

#include "boards/time_base.h"
#include "calibration_slots.h"
#include "gyroscope_calibration.h"
#include "sensor_set.h"
#include "sensors/sampler.h"
#include "vector_statistics.h"

#define RADIANS_PER_DEGREE 0.017453293f
#define QUATERNION_SCALE 32767.0f
/* Accelerometer and magnetometer alone have nothing to do with the filter's gate. */
#define NO_GATE_G 1.0e6f

/* What was set up, and what is kept. */
static struct {
    bool started;
    fusion_settings_t settings;
    float first[4];
    uint16_t count;
    fusion_record_t records[FUSION_RECORDS_MAXIMUM];
} kept;

/* What goes on in one run. */
typedef struct {
    sampler_t gyroscope;
    sampler_t magnetometer;
    const sensor_t *accelerometer;
    fusion_t fused;
    fusion_t turned;
    float rate_rad_s[3]; /* the latest */
    bool rate_known;
    uint64_t at_us; /* of the attitudes */
    uint32_t corrections;
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

/** Means of `readings` magnetometer samples and of the accelerometer's latest at each. */
static sensor_status_t mean_at_rest(uint16_t readings, uint64_t deadline_us, float acceleration[3], float magnetic[3])
{
    const sensor_t *accelerometer = sensor_set_selected(SENSOR_ACCELEROMETER);
    vector_statistics_t gravities = {0};
    vector_statistics_t fields = {0};
    sampler_t sampler;
    sensor_status_t status = sampler_start(&sampler, sensor_set_selected(SENSOR_MAGNETOMETER));
    for (uint16_t i = 0; i < readings && status == SENSOR_OK; i++) {
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

status_t fusion_run_start(const fusion_settings_t *settings, uint16_t readings, uint64_t deadline_us, float attitude[4])
{
    kept.started = false;
    kept.count = 0;
    kept.settings = *settings;
    const sensor_t *gyroscope = sensor_set_selected(SENSOR_GYROSCOPE);
    if (sensor_set_selected(SENSOR_ACCELEROMETER) == NULL || sensor_set_selected(SENSOR_MAGNETOMETER) == NULL ||
        gyroscope == NULL) {
        return STATUS_SENSOR_ABSENT;
    }
    if (slot_get(settings->slot) == NULL) {
        return STATUS_NO_CALIBRATION;
    }
    sampler_t woken; /* a gyroscope that has to be set up again is silent for 60 ms: now, not when the board moves */
    float acceleration[3], magnetic[3], gravity_g[3], field[3];
    sensor_status_t status = sampler_start(&woken, gyroscope);
    if (status == SENSOR_OK) {
        status = mean_at_rest(readings, deadline_us, acceleration, magnetic);
    }
    if (status != SENSOR_OK) {
        return status_of_sensor(status);
    }
    calibrated(acceleration, magnetic, gravity_g, field);
    if (fusion_triad(gravity_g, field, NO_GATE_G, attitude) != FUSION_OK) {
        return STATUS_DEGENERATE_FIELD;
    }
    for (uint32_t i = 0; i < 4u; i++) {
        kept.first[i] = attitude[i];
    }
    kept.started = true;
    return STATUS_OK;
}

/** Bring the attitudes to a moment by a rate that counts as constant since the last one. */
static void predict_until(run_t *run, uint64_t now_us, const float rate_rad_s[3])
{
    const fusion_noise_t *noise = &kept.settings.noise;
    const float dt_s = (float)(uint32_t)(now_us - run->at_us) * 1.0e-6f;
    if (timed_predict(&run->summary->predicted, &run->fused, noise, rate_rad_s, dt_s) != FUSION_OK) {
        run->summary->bad_steps++;
    }
    (void)fusion_predict(&run->turned, noise, rate_rad_s, dt_s);
    run->at_us = now_us;
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
    predict_until(run, sample->time_us, mean_rad_s);
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

/** A new field, with the accelerometer's latest: correct, and keep one in so many. */
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
    predict_until(run, sample->time_us, run->rate_rad_s);
    switch (timed_update(&run->summary->updated, &run->fused, &kept.settings.noise, gravity_g, field)) {
    case FUSION_NO_ATTITUDE:
        run->summary->no_attitude++;
        break;
    case FUSION_ACCELERATED:
        run->summary->accelerated++;
        break;
    case FUSION_OK:
    case FUSION_BAD_STEP:
        break;
    }
    if (run->corrections++ % kept.settings.every == 0u) {
        float measured[4] = {0};
        (void)fusion_triad(gravity_g, field, NO_GATE_G, measured);
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
    fusion_start(&run->fused, &kept.settings.noise, kept.first);
    fusion_start(&run->turned, &kept.settings.noise, kept.first);
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
