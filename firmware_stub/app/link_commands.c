/**
 * @file link_commands.c
 * @brief SYNC, IDENTITY, LINK_STATISTICS and RESET.
 */
#include "boards/board.h"
#include "boards/uart.h"
#include "build_id.h"
#include "calibration/magnetometer_calibrator.h"
#include "calibration_slots.h"
#include "command.h"
#include "points_buffer.h"
#include "server.h"
#include "stream_set.h"
#include "timed_run.h"
#include "version.h"

#define COMPILER "arm-none-eabi-gcc " __VERSION__

enum { CYCLE_SOURCE_NONE = 0, CYCLE_SOURCE_DWT = 1 };

status_t command_sync(payload_reader_t *request, payload_writer_t *reply)
{
    write_u32(reply, read_u32(request));
    write_u16(reply, PROTOCOL_VERSION);
    return STATUS_OK;
}

static void write_unique_id(payload_writer_t *reply)
{
    uint32_t id[4];
    board_unique_id(id);
    for (size_t i = 0; i < 4u; i++) {
        write_u32(reply, id[i]);
    }
}

status_t command_identity(payload_reader_t *request, payload_writer_t *reply)
{
    (void)request;
    write_u16(reply, PROTOCOL_VERSION);
    write_u32(reply, board.core_clock_hz);
    write_u8(reply, timed_run_has_counter() ? CYCLE_SOURCE_DWT : CYCLE_SOURCE_NONE);
    write_u16(reply, POINTS_MAXIMUM);
    write_u8(reply, SLOT_COUNT);
    write_unique_id(reply);
    write_string(reply, board.name);
    write_string(reply, FIRMWARE_VERSION);
    write_string(reply, build_id);
    write_string(reply, COMPILER);
    write_string(reply, board.placement);
    write_u8(reply, calibrator_count);
    for (uint8_t i = 0; i < calibrator_count; i++) {
        write_string(reply, calibrators[i].name);
    }
    write_u8(reply, stream_set_count());
    for (uint8_t i = 0; i < stream_set_count(); i++) {
        write_string(reply, stream_set_get(i)->name);
    }
    return STATUS_OK;
}

status_t command_link_statistics(payload_reader_t *request, payload_writer_t *reply)
{
    (void)request;
    const server_statistics_t statistics = server_statistics();
    write_u32(reply, statistics.frames);
    write_u32(reply, statistics.damaged);
    write_u32(reply, uart_overruns());
    write_u32(reply, statistics.repeated);
    return STATUS_OK;
}

status_t command_reset(payload_reader_t *request, payload_writer_t *reply)
{
    (void)request;
    (void)reply;
    server_reset_after_reply();
    return STATUS_OK;
}
