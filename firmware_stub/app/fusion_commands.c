/**
 * @file fusion_commands.c
 * @brief FUSION_START, FUSION_RUN and FUSION_READ.
 */
#include "boards/time_base.h"
#include "calibration_slots.h"
#include "command.h"
#include "fusion_run.h"
#include "timed_run.h"

#define READINGS_MAXIMUM 512u
#define READ_MAXIMUM 36u
/* Five minutes: its updates can be counted in 16 bits with any sensor. */
#define DURATION_MAXIMUM_US 300000000u

status_t command_start_fusion(payload_reader_t *request, payload_writer_t *reply)
{
    fusion_settings_t settings;
    settings.slot = read_u8(request);
    settings.every = read_u8(request);
    settings.readings = read_u16(request);
    const uint32_t timeout_us = read_u32(request);
    if (settings.slot >= SLOT_COUNT || settings.every == 0u || settings.readings == 0u ||
        settings.readings > READINGS_MAXIMUM || timeout_us > TIMEOUT_MAXIMUM_US) {
        return STATUS_BAD_ARGUMENT;
    }
    float attitude[4];
    const status_t status = fusion_run_start(&settings, time_us() + timeout_us, attitude);
    if (status == STATUS_OK) {
        write_f32_array(reply, attitude, 4);
    }
    return status;
}

status_t command_run_fusion(payload_reader_t *request, payload_writer_t *reply)
{
    const uint32_t duration_us = read_u32(request);
    if (duration_us == 0u || duration_us > DURATION_MAXIMUM_US) {
        return STATUS_BAD_ARGUMENT;
    }
    fusion_summary_t summary = {0};
    const status_t status = fusion_run(time_us() + duration_us, &summary);
    if (status != STATUS_OK) {
        return status;
    }
    write_u64(reply, summary.began_us);
    write_u16(reply, summary.records);
    write_u16(reply, summary.no_attitude);
    write_u16(reply, summary.field_left_out);
    write_u16(reply, summary.bad_steps);
    write_u16(reply, summary.overruns);
    write_u32(reply, summary.costs.updates);
    write_u32(reply, summary.costs.largest_cycles);
    write_u32(reply, summary.costs.total_cycles);
    write_u32(reply, summary.costs.overhead_cycles);
    return timed_run_has_counter() ? STATUS_OK : STATUS_NO_CYCLE_COUNTER;
}

static void write_quaternion(payload_writer_t *reply, const int16_t quaternion[4])
{
    for (uint32_t i = 0; i < 4u; i++) {
        write_i16(reply, quaternion[i]);
    }
}

status_t command_read_fusion(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t first = read_u16(request);
    const uint8_t wanted = read_u8(request);
    if (wanted > READ_MAXIMUM || first > fusion_record_count()) {
        return STATUS_BAD_ARGUMENT;
    }
    const uint16_t left = (uint16_t)(fusion_record_count() - first);
    const uint8_t count = wanted < left ? wanted : (uint8_t)left;
    write_u8(reply, count);
    for (uint16_t i = first; i < first + count; i++) {
        const fusion_record_t *record = fusion_record(i);
        write_u32(reply, record->time_us);
        write_quaternion(reply, record->fused);
        write_quaternion(reply, record->measured);
        write_quaternion(reply, record->turned);
    }
    return STATUS_OK;
}
