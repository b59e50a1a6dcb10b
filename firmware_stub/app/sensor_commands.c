/**
 * @file sensor_commands.c
 * @brief SENSORS, SELECT and READ.
 */
#include "boards/board_sensors.h"
#include "boards/time_base.h"
#include "command.h"
#include "sensor_set.h"
#include "sensors/sampler.h"

#define READ_MAXIMUM 64u

status_t command_sensors(payload_reader_t *request, payload_writer_t *reply)
{
    (void)request;
    write_u8(reply, board_sensor_count);
    for (uint8_t id = 0; id < board_sensor_count; id++) {
        const sensor_t *sensor = &board_sensors[id];
        uint8_t seen = 0;
        const bool present = sensor_set_is_present(id, &seen);
        write_u8(reply, id);
        write_u8(reply, (uint8_t)sensor->driver->kind);
        write_u8(reply, sensor->bus);
        write_u8(reply, sensor->address);
        write_u8(reply, sensor->driver->who_am_i);
        write_u8(reply, seen);
        write_u8(reply, present);
        write_u8(reply, sensor_set_is_selected(id));
        write_string(reply, sensor->name);
    }
    return STATUS_OK;
}

status_t command_select(payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    const uint8_t id = read_u8(request);
    return id < board_sensor_count ? sensor_set_select(id) : STATUS_NO_SUCH_SENSOR;
}

static status_t write_samples(sampler_t *sampler, uint8_t count, uint64_t deadline_us, payload_writer_t *reply)
{
    write_u8(reply, count);
    for (uint8_t i = 0; i < count; i++) {
        sample_t sample;
        const sensor_status_t status = sampler_next(sampler, &sample, deadline_us);
        if (status != SENSOR_OK) {
            return status_of_sensor(status);
        }
        write_u64(reply, sample.time_us);
        write_vector_i16(reply, sample.body);
    }
    write_u16(reply, sampler->overruns);
    return STATUS_OK;
}

status_t command_read(payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t id = read_u8(request);
    const uint8_t count = read_u8(request);
    const uint32_t timeout_us = read_u32(request);
    if (id >= board_sensor_count) {
        return STATUS_NO_SUCH_SENSOR;
    }
    if (count == 0u || count > READ_MAXIMUM || timeout_us > TIMEOUT_MAXIMUM_US) {
        return STATUS_BAD_ARGUMENT;
    }
    const uint64_t deadline_us = time_us() + timeout_us;
    status_t status = sensor_set_prepare(id);
    if (status != STATUS_OK) {
        return status;
    }
    sampler_t sampler;
    status = status_of_sensor(sampler_start(&sampler, &board_sensors[id]));
    if (status == STATUS_OK) {
        status = write_samples(&sampler, count, deadline_us, reply);
    }
    if (status == STATUS_OK) {
        int8_t degc = 0;
        status = status_of_sensor(sensor_die_temperature(&board_sensors[id], &degc));
        write_i8(reply, degc);
    }
    return status;
}
