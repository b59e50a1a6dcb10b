/**
 * @file accelerometer_commands.c
 * @brief SET_ACCELEROMETER and GET_ACCELEROMETER.
 */
#include "calibration_slots.h"
#include "command.h"
#include "linear_fields.h"

status_t command_set_accelerometer(payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    accelerometer_calibration_t calibration;
    const uint8_t slot = read_u8(request);
    const bool is_finite = read_linear(request, calibration.gain, calibration.offset);
    if (slot >= SLOT_COUNT || !is_finite) {
        return STATUS_BAD_ARGUMENT;
    }
    slot_set_accelerometer(slot, &calibration);
    return STATUS_OK;
}

status_t command_get_accelerometer(payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t slot = read_u8(request);
    if (slot >= SLOT_COUNT) {
        return STATUS_BAD_ARGUMENT;
    }
    const accelerometer_calibration_t *calibration = slot_accelerometer(slot);
    write_linear(reply, calibration->gain, calibration->offset);
    return STATUS_OK;
}
