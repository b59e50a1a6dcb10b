/**
 * @file gyroscope_commands.c
 * @brief GYROSCOPE_REST, INTEGRATE_GYROSCOPE and LOG_GYROSCOPE: the gyroscope through its FIFO, sample by sample without a gap.
 */
#include <math.h>

#include "boards/time_base.h"
#include "command.h"
#include "gyroscope_calibration.h"
#include "sample_series.h"
#include "sensor_set.h"
#include "sensors/fifo_sampler.h"
#include "stillness.h"
#include "vector_statistics.h"

#define REST_MAXIMUM 4096u
#define TURN_MAXIMUM 12000u /* what 60 s give at 200 Hz */
#define LOG_MAXIMUM 128u
/** Samples whose sum is reported from either end of a turn, so that the host sees whether it stood still there. */
#define EDGE_SAMPLES 20u

/** Is called with every sample of a series; `index` counts from 0. */
typedef void (*sample_taker_t)(void *context, uint32_t index, const int16_t body[3]);

__attribute__((noinline)) static sensor_status_t
for_each_sample(fifo_sampler_t *sampler, uint32_t count, uint64_t deadline_us, sample_taker_t take, void *context)
{
    uint32_t done = 0;
    while (done < count) {
        int16_t body[SENSOR_FIFO_BURST][3];
        uint8_t taken = 0;
        const sensor_status_t status = fifo_sampler_take(sampler, count - done, deadline_us, body, &taken);
        if (status != SENSOR_OK) {
            return status;
        }
        for (uint8_t i = 0; i < taken; i++) {
            take(context, done + i, body[i]);
        }
        done += taken;
    }
    return SENSOR_OK;
}

/** Set the FIFO going and give every sample of a series to `take`; then ask for the temperature. */
static status_t sample(fifo_sampler_t *sampler, uint32_t count, uint32_t timeout_us, sample_taker_t take, void *context,
                       int8_t *degc)
{
    const uint64_t deadline_us = time_us() + timeout_us;
    const sensor_t *sensor = sensor_set_selected(SENSOR_GYROSCOPE);
    if (sensor == NULL) {
        return STATUS_SENSOR_ABSENT;
    }
    sensor_status_t status = fifo_sampler_start(sampler, sensor, deadline_us);
    if (status == SENSOR_OK) {
        status = for_each_sample(sampler, count, deadline_us, take, context);
    }
    if (status == SENSOR_OK) {
        status = sensor_die_temperature(sensor, degc);
    }
    return status_of_sensor(status);
}

static void write_span(payload_writer_t *reply, const fifo_sampler_t *sampler)
{
    write_u64(reply, sampler->first_us);
    write_u64(reply, sampler->looked_us);
    write_u8(reply, sampler->lost);
}

typedef struct {
    vector_statistics_t statistics;
    stillness_t stillness;
} rest_t;

static void take_rest(void *context, uint32_t index, const int16_t body[3])
{
    (void)index;
    rest_t *rest = context;
    statistics_add(&rest->statistics, body);
    stillness_add(&rest->stillness, body);
}

/** A rest that should be tested must have been found still. */
static bool may_be_stored(const rest_t *rest, const fifo_sampler_t *sampler)
{
    const bool is_to_be_tested = rest->stillness.noise > 0.0f;
    return !sampler->lost && (!is_to_be_tested || rest->stillness.verdict.kind == STILLNESS_STILL);
}

static void write_rest(payload_writer_t *reply, const rest_t *rest)
{
    float corrected[3];
    statistics_mean(&rest->statistics, corrected);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        corrected[axis] -= gyroscope_calibration()->bias[axis];
    }
    write_statistics(reply, &rest->statistics);
    write_f32_array(reply, corrected, 3);
}

static void write_stillness(payload_writer_t *reply, const stillness_verdict_t *verdict)
{
    write_u8(reply, (uint8_t)verdict->kind);
    write_u8(reply, verdict->axis);
    write_u16(reply, (uint16_t)verdict->first);
    write_f32_array(reply, &verdict->amount, 1);
}

status_t command_gyroscope_rest(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t count = read_u16(request);
    const uint32_t timeout_us = read_u32(request);
    const uint8_t store = read_u8(request);
    const float noise = read_f32(request);
    if (count == 0u || count > REST_MAXIMUM || timeout_us > TIMEOUT_MAXIMUM_US || store > 1u || !isfinite(noise) ||
        noise < 0.0f) {
        return STATUS_BAD_ARGUMENT;
    }
    rest_t rest = {.statistics = {.count = 0}};
    stillness_start(&rest.stillness, noise);
    fifo_sampler_t sampler;
    int8_t degc = 0;
    const status_t status = sample(&sampler, count, timeout_us, take_rest, &rest, &degc);
    if (status != STATUS_OK) {
        return status;
    }
    write_u16(reply, count);
    write_rest(reply, &rest);
    write_i8(reply, degc);
    write_span(reply, &sampler);
    write_stillness(reply, &rest.stillness.verdict);
    if (store == 1u && may_be_stored(&rest, &sampler)) {
        float mean[3];
        statistics_mean(&rest.statistics, mean);
        gyroscope_bias_set(mean);
    }
    return STATUS_OK;
}

typedef struct {
    uint16_t count; /**< samples that there will be */
    int32_t sum[3];
    int32_t begin[3]; /**< sum of the first EDGE_SAMPLES */
    int32_t end[3];   /**< and of the last */
    int16_t lowest[3];
    int16_t highest[3];
} turn_t;

static void take_turn(void *context, uint32_t index, const int16_t body[3])
{
    turn_t *turn = context;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const int16_t value = body[axis];
        turn->sum[axis] += value; /* 12 000 samples of 2^15 fit */
        turn->begin[axis] += index < EDGE_SAMPLES ? value : 0;
        turn->end[axis] += index + EDGE_SAMPLES >= turn->count ? value : 0;
        turn->lowest[axis] = value < turn->lowest[axis] ? value : turn->lowest[axis];
        turn->highest[axis] = value > turn->highest[axis] ? value : turn->highest[axis];
    }
}

static void write_i32(payload_writer_t *reply, const int32_t vector[3])
{
    for (uint32_t axis = 0; axis < 3u; axis++) {
        write_u32(reply, (uint32_t)vector[axis]);
    }
}

status_t command_integrate_gyroscope(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t count = read_u16(request);
    const uint32_t timeout_us = read_u32(request);
    if (count < 2u * EDGE_SAMPLES || count > TURN_MAXIMUM || timeout_us > TIMEOUT_MAXIMUM_US) {
        return STATUS_BAD_ARGUMENT;
    }
    turn_t turn = {
        .count = count,
        .lowest = {INT16_MAX, INT16_MAX, INT16_MAX},
        .highest = {INT16_MIN, INT16_MIN, INT16_MIN},
    };
    fifo_sampler_t sampler;
    int8_t degc = 0;
    const status_t status = sample(&sampler, count, timeout_us, take_turn, &turn, &degc);
    if (status != STATUS_OK) {
        return status;
    }
    write_u16(reply, count);
    write_i32(reply, turn.sum);
    write_i32(reply, turn.begin);
    write_i32(reply, turn.end);
    write_vector_i16(reply, turn.lowest);
    write_vector_i16(reply, turn.highest);
    write_i8(reply, degc);
    write_span(reply, &sampler);
    return STATUS_OK;
}

static void take_log(void *context, uint32_t index, const int16_t body[3])
{
    (void)index;
    write_vector_i16(context, body);
}

status_t command_log_gyroscope(payload_reader_t *request, payload_writer_t *reply)
{
    static fifo_sampler_t sampler; /* goes on from request to request */
    uint8_t count = read_u8(request);
    const uint8_t go_on = read_u8(request);
    const uint32_t timeout_us = read_u32(request);
    if (count > LOG_MAXIMUM || go_on > 1u || timeout_us > TIMEOUT_MAXIMUM_US) {
        return STATUS_BAD_ARGUMENT;
    }
    const uint64_t deadline_us = time_us() + timeout_us;
    const sensor_t *sensor = sensor_set_selected(SENSOR_GYROSCOPE);
    if (sensor == NULL) {
        return STATUS_SENSOR_ABSENT;
    }
    sensor_status_t status = SENSOR_OK;
    sampler.lost = false;
    if (go_on == 0u || !fifo_sampler_goes_on(&sampler, sensor)) {
        status = fifo_sampler_start(&sampler, sensor, deadline_us);
        sampler.lost = go_on == 1u; /* there was nothing to go on with: what lies between is lost */
    }
    if (status == SENSOR_OK && count == 0u) {
        status = fifo_sampler_waiting(&sampler, &count);
        count = count == 0u ? 1u : count; /* then the next one is waited for */
    }
    write_u8(reply, count);
    if (status == SENSOR_OK) {
        status = for_each_sample(&sampler, count, deadline_us, take_log, reply);
    }
    int8_t degc = 0;
    if (status == SENSOR_OK) {
        status = sensor_die_temperature(sensor, &degc);
    }
    write_i8(reply, degc);
    write_span(reply, &sampler);
    return status_of_sensor(status);
}
