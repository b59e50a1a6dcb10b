/**
 * @file calibration_commands.c
 * @brief CALIBRATE, SET_CALIBRATION, GET_CALIBRATION and CLEAR_CALIBRATION.
 */
#include <string.h>

#include "calibration_slots.h"
#include "command.h"
#include "fit_fields.h"
#include "linear_fields.h"
#include "points_buffer.h"
#include "timed_run.h"

static const calibrator_entry_t *find_calibrator(const char *name, uint8_t length)
{
    for (uint8_t i = 0; i < calibrator_count; i++) {
        if (strlen(calibrators[i].name) == length && memcmp(calibrators[i].name, name, length) == 0) {
            return &calibrators[i];
        }
    }
    return NULL;
}

status_t command_calibrate(payload_reader_t *request, payload_writer_t *reply)
{
    const uint16_t count = read_u16(request);
    const uint16_t iterations = read_u16(request);
    uint8_t name_length = 0;
    const char *name = read_string(request, &name_length);
    if (!reader_is_exhausted(request)) {
        return STATUS_BAD_LENGTH;
    }
    const calibrator_entry_t *calibrator = find_calibrator(name, name_length);
    if (calibrator == NULL) {
        return STATUS_UNKNOWN_CALIBRATOR;
    }
    if (count == 0u) {
        return STATUS_BAD_ARGUMENT;
    }
    if (count > points_count()) {
        return STATUS_TOO_FEW_POINTS;
    }
    magnetometer_points_t points = points_first(count);
    points.iterations = iterations;
    magnetometer_fit_t fit = {.status = FIT_SINGULAR};
    const run_cost_t cost = timed_run(calibrator->run, &points, &fit);
    write_fit(reply, &fit, 0);
    write_u32(reply, cost.cycles);
    write_u32(reply, cost.overhead_cycles);
    return timed_run_has_counter() ? STATUS_OK : STATUS_NO_CYCLE_COUNTER;
}

status_t command_set_calibration(payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    const uint8_t slot = read_u8(request);
    calibration_t calibration;
    const bool is_finite = read_linear(request, calibration.soft_iron, calibration.hard_iron);
    if (slot >= SLOT_COUNT || !is_finite) {
        return STATUS_BAD_ARGUMENT;
    }
    slot_set(slot, &calibration);
    return STATUS_OK;
}

status_t command_get_calibration(payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t slot = read_u8(request);
    if (slot >= SLOT_COUNT) {
        return STATUS_BAD_ARGUMENT;
    }
    const calibration_t *calibration = slot_get(slot);
    if (calibration == NULL) {
        return STATUS_NO_CALIBRATION;
    }
    write_linear(reply, calibration->soft_iron, calibration->hard_iron);
    return STATUS_OK;
}

status_t command_clear_calibration(payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    const uint8_t slot = read_u8(request);
    if (slot >= SLOT_COUNT) {
        return STATUS_BAD_ARGUMENT;
    }
    slot_clear(slot);
    return STATUS_OK;
}
