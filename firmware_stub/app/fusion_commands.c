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
#define RADIANS_PER_DEGREE 0.017453293f
/* Standard deviations outside are no sensor's; their squares, in radians, would leave float32. */
#define SMALLEST_DEG 1.0e-4f
#define LARGEST_DEG 180.0f

/** Variance [rad^2] of a standard deviation [deg]; false when it is none. */
static bool read_variance(payload_reader_t *request, float *variance)
{
    const float sigma_deg = read_f32(request);
    const float sigma_rad = RADIANS_PER_DEGREE * sigma_deg;
    *variance = sigma_rad * sigma_rad;
    return sigma_deg >= SMALLEST_DEG && sigma_deg <= LARGEST_DEG;
}

status_t command_start_fusion(payload_reader_t *request, payload_writer_t *reply)
{
    fusion_settings_t settings;
    settings.slot = read_u8(request);
    settings.every = read_u8(request);
    const uint16_t readings = read_u16(request);
    const uint32_t timeout_us = read_u32(request);
    bool valid = read_variance(request, &settings.noise.rate_variance);
    valid = read_variance(request, &settings.noise.tilt_variance) && valid;
    valid = read_variance(request, &settings.noise.heading_variance) && valid;
    settings.noise.gate_g = read_f32(request);
    if (!valid || !(settings.noise.gate_g >= 0.0f) || settings.slot >= SLOT_COUNT || settings.every == 0u ||
        readings == 0u || readings > READINGS_MAXIMUM || timeout_us > TIMEOUT_MAXIMUM_US) {
        return STATUS_BAD_ARGUMENT;
    }
    float attitude[4];
    const status_t status = fusion_run_start(&settings, readings, time_us() + timeout_us, attitude);
    if (status == STATUS_OK) {
        write_f32_array(reply, attitude, 4);
    }
    return status;
}

static void write_costs(payload_writer_t *reply, const step_costs_t *costs)
{
    write_u32(reply, costs->steps);
    write_u32(reply, costs->largest_cycles);
    write_u32(reply, costs->total_cycles);
    write_u32(reply, costs->overhead_cycles);
}

status_t command_run_fusion(payload_reader_t *request, payload_writer_t *reply)
{
    const uint32_t duration_us = read_u32(request);
    if (duration_us == 0u || duration_us > TIMEOUT_MAXIMUM_US) {
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
    write_u16(reply, summary.accelerated);
    write_u16(reply, summary.bad_steps);
    write_u16(reply, summary.overruns);
    write_costs(reply, &summary.predicted);
    write_costs(reply, &summary.updated);
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
