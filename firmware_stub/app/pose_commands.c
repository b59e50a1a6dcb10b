/**
 * @file pose_commands.c
 * @brief ADD_POSE, POSES, CLEAR_POSES and UPLOAD_POSES.
 */
#include <math.h>

#include "boards/time_base.h"
#include "command.h"
#include "pose_buffer.h"
#include "sample_series.h"
#include "sensor_set.h"

#define READINGS_MAXIMUM 512u
#define POSE_BYTES 51u
#define TRANSFER_MAXIMUM 20u

static bool is_face(uint8_t face)
{
    return face < FACE_COUNT || face == FACE_NONE;
}

status_t command_add_pose(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t count = read_u16(request);
    const uint32_t timeout_us = read_u32(request);
    still_pose_t pose = {.readings = count, .face = read_u8(request)};
    if (count == 0u || count > READINGS_MAXIMUM || timeout_us > TIMEOUT_MAXIMUM_US || !is_face(pose.face)) {
        return STATUS_BAD_ARGUMENT;
    }
    if (poses_count() == POSES_MAXIMUM) {
        return STATUS_BUFFER_FULL;
    }
    series_t series[ATTITUDE_KINDS];
    int8_t degc = 0;
    status_t status = series_fill(series, count, time_us() + timeout_us);
    if (status == STATUS_OK) {
        status = status_of_sensor(sensor_die_temperature(series[SENSOR_ACCELEROMETER].sampler.sensor, &degc));
    }
    if (status != STATUS_OK) {
        return status;
    }
    statistics_mean(&series[SENSOR_MAGNETOMETER].statistics, pose.magnetometer);
    statistics_spread(&series[SENSOR_MAGNETOMETER].statistics, pose.magnetometer_spread);
    statistics_mean(&series[SENSOR_ACCELEROMETER].statistics, pose.accelerometer);
    statistics_spread(&series[SENSOR_ACCELEROMETER].statistics, pose.accelerometer_spread);
    write_u8(reply, poses_count());
    (void)poses_store(&pose); /* room was checked */
    write_series(reply, series, count);
    write_i8(reply, degc);
    return STATUS_OK;
}

status_t command_poses(payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t first = read_u8(request);
    const uint8_t wanted = read_u8(request);
    if (wanted > TRANSFER_MAXIMUM || first > poses_count()) {
        return STATUS_BAD_ARGUMENT;
    }
    const uint8_t stored = (uint8_t)(poses_count() - first);
    const uint8_t count = wanted < stored ? wanted : stored;
    write_u8(reply, count);
    for (uint8_t i = 0; i < count; i++) {
        const still_pose_t *pose = &poses_stored()[first + i];
        write_u8(reply, pose->face);
        write_u16(reply, pose->readings);
        write_f32_array(reply, pose->magnetometer, 3);
        write_f32_array(reply, pose->magnetometer_spread, 3);
        write_f32_array(reply, pose->accelerometer, 3);
        write_f32_array(reply, pose->accelerometer_spread, 3);
    }
    return STATUS_OK;
}

status_t command_clear_poses(payload_reader_t *request, payload_writer_t *reply)
{
    (void)request;
    (void)reply;
    poses_clear();
    return STATUS_OK;
}

/** Read a mean and a spread. False when the mean is no number, or the spread neither one from 0 on nor NaN. */
static bool read_statistics(payload_reader_t *request, float mean[3], float spread[3])
{
    bool good = true;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        mean[axis] = read_f32(request);
        good = good && isfinite(mean[axis]);
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        spread[axis] = read_f32(request);
        good = good && (isnan(spread[axis]) || (spread[axis] >= 0.0f && isfinite(spread[axis])));
    }
    return good;
}

static bool read_pose(payload_reader_t *request, still_pose_t *pose)
{
    pose->face = read_u8(request);
    pose->readings = read_u16(request);
    const bool magnetometer_good = read_statistics(request, pose->magnetometer, pose->magnetometer_spread);
    const bool accelerometer_good = read_statistics(request, pose->accelerometer, pose->accelerometer_spread);
    return is_face(pose->face) && pose->readings > 0u && magnetometer_good && accelerometer_good;
}

status_t command_upload_poses(payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t first = read_u8(request);
    const uint8_t count = read_u8(request);
    if (request->length - request->position != (size_t)count * POSE_BYTES) {
        return STATUS_BAD_LENGTH;
    }
    if (first != poses_count() || count > TRANSFER_MAXIMUM) {
        return STATUS_BAD_ARGUMENT;
    }
    if (count > POSES_MAXIMUM - poses_count()) {
        return STATUS_BUFFER_FULL;
    }
    still_pose_t poses[TRANSFER_MAXIMUM]; /* none is stored unless all are good */
    for (uint8_t i = 0; i < count; i++) {
        if (!read_pose(request, &poses[i])) {
            return STATUS_BAD_ARGUMENT;
        }
    }
    for (uint8_t i = 0; i < count; i++) {
        (void)poses_store(&poses[i]);
    }
    write_u8(reply, poses_count());
    return STATUS_OK;
}
