/**
 * @file gyroscope_calibration_commands.c
 * @brief FIT_GYROSCOPE, SET_GYROSCOPE and GET_GYROSCOPE.
 */
#include "calibration/fast_code.h"
#include "calibration/gyroscope_turns.h"
#include "command.h"
#include "gyroscope_calibration.h"
#include "linear_fields.h"
#include "timed_run.h"

static bool read_turn(payload_reader_t *request, gyroscope_turn_t *turn)
{
    bool is_finite = read_finite(request, turn->turned_deg, 3);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        turn->sum[axis] = (int32_t)read_u32(request);
    }
    turn->count = read_u16(request);
    turn->duration_us = read_u32(request);
    is_finite = read_finite(request, turn->bias_before, 3) && is_finite;
    is_finite = read_finite(request, turn->bias_after, 3) && is_finite;
    return read_finite(request, &turn->share, 1) && is_finite;
}

FAST_CODE static void fit_turns(const void *turns, void *fit)
{
    gyroscope_turns_fit(turns, fit);
}

status_t command_fit_gyroscope(payload_reader_t *request, payload_writer_t *reply)
{
    gyroscope_turn_t turn[GYROSCOPE_TURNS_MAXIMUM];
    const gyroscope_turns_t turns = {.turns = turn, .count = read_u8(request)};
    if (turns.count == 0u || turns.count > GYROSCOPE_TURNS_MAXIMUM) {
        return STATUS_BAD_ARGUMENT;
    }
    bool is_finite = true;
    for (uint8_t i = 0; i < turns.count; i++) {
        is_finite = read_turn(request, &turn[i]) && is_finite;
    }
    if (!reader_is_exhausted(request)) {
        return STATUS_BAD_LENGTH;
    }
    if (!is_finite) {
        return STATUS_BAD_ARGUMENT;
    }
    gyroscope_turns_fit_t fit;
    const run_cost_t cost = timed_work(fit_turns, &turns, &fit);
    write_u8(reply, (uint8_t)fit.status);
    write_u8(reply, fit.at_fault);
    write_f32_array(reply, fit.matrix, 9);
    write_f32_array(reply, &fit.residual_deg, 1);
    write_u32(reply, cost.cycles);
    write_u32(reply, cost.overhead_cycles);
    return timed_run_has_counter() ? STATUS_OK : STATUS_NO_CYCLE_COUNTER;
}

status_t command_set_gyroscope(payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    gyroscope_calibration_t calibration;
    if (!read_linear(request, calibration.matrix, calibration.bias)) {
        return STATUS_BAD_ARGUMENT;
    }
    gyroscope_calibration_set(&calibration);
    return STATUS_OK;
}

status_t command_get_gyroscope(payload_reader_t *request, payload_writer_t *reply)
{
    (void)request;
    write_linear(reply, gyroscope_calibration()->matrix, gyroscope_calibration()->bias);
    return STATUS_OK;
}
