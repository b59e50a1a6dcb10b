/**
 * @file point_commands.c
 * @brief COLLECT, UPLOAD, POINTS, CLEAR_POINTS and TIME_RANGE.
 */
#include "boards/time_base.h"
#include "calibration/point_range.h"
#include "command.h"
#include "pair_collector.h"
#include "points_buffer.h"
#include "sensor_set.h"
#include "timed_run.h"

#define VECTOR_BYTES 6u
#define UPLOAD_MAXIMUM 160u
#define POINTS_REPLY_MAXIMUM 80u

status_t command_collect(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t count = read_u16(request);
    const uint32_t timeout_us = read_u32(request);
    if (count == 0u || count > POINTS_MAXIMUM || timeout_us > TIMEOUT_MAXIMUM_US) {
        return STATUS_BAD_ARGUMENT;
    }
    if (count > POINTS_MAXIMUM - points_count()) {
        return STATUS_BUFFER_FULL;
    }
    const sensor_t *const magnetometer = sensor_set_selected(SENSOR_MAGNETOMETER);
    const sensor_t *const accelerometer = sensor_set_selected(SENSOR_ACCELEROMETER);
    if (magnetometer == NULL || accelerometer == NULL) {
        return STATUS_SENSOR_ABSENT;
    }
    uint16_t overruns = 0;
    const sensor_status_t status =
        collect_pairs(magnetometer, accelerometer, count, time_us() + timeout_us, &overruns);
    if (status != SENSOR_OK) {
        return status_of_sensor(status);
    }
    const magnetometer_points_t points = points_first(points_count());
    write_u16(reply, points_count());
    write_vector_i16(reply, points.minimum);
    write_vector_i16(reply, points.maximum);
    write_u16(reply, overruns);
    return STATUS_OK;
}

/** Points of the magnetometer alone, or pairs: the length says which. */
status_t command_upload(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t first = read_u16(request);
    const uint8_t count = read_u8(request);
    const size_t bytes = request->length - request->position;
    const bool are_pairs = count != 0u && bytes == 2u * count * VECTOR_BYTES;
    if (!are_pairs && bytes != count * VECTOR_BYTES) {
        return STATUS_BAD_LENGTH;
    }
    if (first != points_count() || count > UPLOAD_MAXIMUM) {
        return STATUS_BAD_ARGUMENT;
    }
    if (count > POINTS_MAXIMUM - points_count()) {
        return STATUS_BUFFER_FULL;
    }
    const size_t step = are_pairs ? 2u * VECTOR_BYTES : VECTOR_BYTES;
    const uint8_t *next = read_bytes(request, bytes); /* as many as there are */
    for (uint8_t i = 0; i < count; i++, next += step) {
        int16_t magnetometer[3];
        int16_t accelerometer[3] = {0, 0, 0};
        vector_i16_of(next, magnetometer);
        if (are_pairs) {
            vector_i16_of(&next[VECTOR_BYTES], accelerometer);
        }
        (void)points_store(magnetometer, accelerometer); /* room was checked */
    }
    write_u16(reply, points_count());
    return STATUS_OK;
}

status_t command_points(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t first = read_u16(request);
    const uint8_t wanted = read_u8(request);
    if (wanted > POINTS_REPLY_MAXIMUM || first > points_count()) {
        return STATUS_BAD_ARGUMENT;
    }
    const uint16_t stored = (uint16_t)(points_count() - first);
    const uint8_t count = wanted < stored ? wanted : (uint8_t)stored;
    write_u8(reply, count);
    for (uint16_t i = first; i < first + count; i++) {
        write_vector_i16(reply, points_magnetometer(i));
        write_vector_i16(reply, points_accelerometer(i));
    }
    return STATUS_OK;
}

status_t command_clear_points(payload_reader_t *request, payload_writer_t *reply)
{
    (void)request;
    (void)reply;
    points_clear();
    return STATUS_OK;
}

status_t command_time_range(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t count = read_u16(request);
    if (count == 0u) {
        return STATUS_BAD_ARGUMENT;
    }
    if (count > points_count()) {
        return STATUS_TOO_FEW_POINTS;
    }
    run_cost_t total = {0};
    point_range_t range;
    stream_status_t status;
    point_range_start(&range, points_magnetometer(0));
    for (uint16_t i = 0; i < count; i++) {
        const run_cost_t cost = timed_step(point_range_add, &range, points_magnetometer(i), &status);
        total.cycles += cost.cycles;
        total.overhead_cycles += cost.overhead_cycles;
    }
    write_u32(reply, total.cycles);
    write_u32(reply, total.overhead_cycles);
    return timed_run_has_counter() ? STATUS_OK : STATUS_NO_CYCLE_COUNTER;
}
