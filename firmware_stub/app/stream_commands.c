/**
 * @file stream_commands.c
 * @brief STREAM_RESET, STREAM_FEED, STREAM_REMOVE and STREAM_STATE.
 */
#include "command.h"
#include "fit_fields.h"
#include "points_buffer.h"
#include "stream_set.h"
#include "timed_run.h"

#define FEED_MAXIMUM 80u
#define RESET_FLAG_SLICED 0x01u
#define STATE_FLAG_SOLVING 0x02u

/** The calibrator whose name ends a request; NULL with the status that says why there is none. */
static const stream_calibrator_t *read_stream(payload_reader_t *request, status_t *status)
{
    uint8_t length = 0;
    const char *name = read_string(request, &length);
    const stream_calibrator_t *stream = stream_set_find(name, length);
    *status = !reader_is_exhausted(request) ? STATUS_BAD_LENGTH : stream == NULL ? STATUS_UNKNOWN_CALIBRATOR : STATUS_OK;
    return *status == STATUS_OK ? stream : NULL;
}

status_t command_reset_stream(payload_reader_t *request, payload_writer_t *reply)
{
    (void)reply;
    status_t status;
    const uint8_t flags = read_u8(request);
    const stream_calibrator_t *stream = read_stream(request, &status);
    if (stream == NULL) {
        return status;
    }
    if (flags > RESET_FLAG_SLICED) {
        return STATUS_BAD_ARGUMENT;
    }
    stream->reset(stream->state, flags == RESET_FLAG_SLICED);
    return STATUS_OK;
}

/** Give points of the buffer to a step, one after the other, until one is refused; cycles of each that was taken. */
static void write_steps(payload_writer_t *reply, stream_step_t step, void *state, uint16_t first, uint8_t count)
{
    stream_status_t status = STREAM_OK;
    run_cost_t costs[FEED_MAXIMUM];
    run_cost_t last = {0};
    uint8_t taken = 0;
    while (taken < count && status == STREAM_OK) {
        last = timed_step(step, state, points_magnetometer((uint16_t)(first + taken)), &status);
        if (status == STREAM_OK) {
            costs[taken++] = last;
        }
    }
    write_u8(reply, (uint8_t)status);
    write_u32(reply, last.overhead_cycles);
    write_u8(reply, taken);
    for (uint8_t i = 0; i < taken; i++) {
        write_u32(reply, costs[i].cycles);
    }
}

static status_t step_over_points(payload_reader_t *request, payload_writer_t *reply, bool removing)
{
    status_t status;
    const uint16_t first = read_u16(request);
    const uint8_t count = read_u8(request);
    const stream_calibrator_t *stream = read_stream(request, &status);
    if (stream == NULL) {
        return status;
    }
    const stream_step_t step = removing ? stream->remove : stream->add;
    if (step == NULL) {
        return STATUS_NOT_SUPPORTED;
    }
    if (count == 0u || count > FEED_MAXIMUM) {
        return STATUS_BAD_ARGUMENT;
    }
    if ((uint32_t)first + count > points_count()) {
        return STATUS_TOO_FEW_POINTS;
    }
    write_steps(reply, step, stream->state, first, count);
    return timed_run_has_counter() ? STATUS_OK : STATUS_NO_CYCLE_COUNTER;
}

status_t command_feed_stream(payload_reader_t *request, payload_writer_t *reply)
{
    return step_over_points(request, reply, false);
}

status_t command_remove_from_stream(payload_reader_t *request, payload_writer_t *reply)
{
    return step_over_points(request, reply, true);
}

status_t command_stream_state(payload_reader_t *request, payload_writer_t *reply)
{
    status_t status;
    const stream_calibrator_t *stream = read_stream(request, &status);
    if (stream == NULL) {
        return status;
    }
    stream_report_t report = {0};
    const run_cost_t cost = timed_report(stream->report, stream->state, &report);
    write_fit(reply, &report.fit, report.is_solving ? STATE_FLAG_SOLVING : 0u);
    write_u16(reply, report.held);
    write_u8(reply, report.elements);
    write_u32(reply, report.accepted);
    write_f32(reply, report.fit_error_percent >= 0.0f ? report.fit_error_percent : __builtin_nanf(""));
    write_u32(reply, cost.cycles);
    write_u32(reply, cost.overhead_cycles);
    return timed_run_has_counter() ? STATUS_OK : STATUS_NO_CYCLE_COUNTER;
}
