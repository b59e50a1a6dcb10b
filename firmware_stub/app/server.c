#include "server.h"

#include <stdbool.h>

#include "boards/board.h"
#include "boards/time_base.h"
#include "boards/uart.h"
#include "command.h"
#include "protocol/message.h"
#include "protocol/payload.h"
#include "protocol/stuffing.h"

/* 2066 bytes take 180 ms at 115200 baud. */
#define SEND_TIMEOUT_US 500000u

_Static_assert(UART_LAST_BYTE == STUFFING_DELIMITER, "the UART must hand over whole frames");

static unstuffer_t unstuffer;
static uint8_t reply_body[BODY_MAXIMUM];
static server_statistics_t statistics;
static bool reset_requested;

/** The last reply as it went out, and the request it answers. */
static struct {
    uint8_t wire[WIRE_MAXIMUM];
    size_t length; /**< 0 before the first reply */
    uint8_t type;
    uint8_t sequence;
    uint32_t crc;
} last;

server_statistics_t server_statistics(void)
{
    return statistics;
}

void server_reset_after_reply(void)
{
    reset_requested = true;
}

static bool is_repeated(const message_t *request)
{
    return last.length > 0u && request->type == last.type && request->sequence == last.sequence && request->crc == last.crc;
}

static status_t execute(const message_t *request, payload_writer_t *reply)
{
    const command_t *command = command_find(request->type);
    if (command == NULL) {
        return STATUS_UNKNOWN_COMMAND;
    }
    if (request->payload_length < command->minimum_length || request->payload_length > command->maximum_length) {
        return STATUS_BAD_LENGTH;
    }
    payload_reader_t reader = {.bytes = request->payload, .length = request->payload_length};
    return command->handler(&reader, reply);
}

/** Execute a request and keep the frame that answers it. */
static void answer(const message_t *request)
{
    payload_writer_t reply = {.bytes = message_payload(reply_body), .capacity = PAYLOAD_MAXIMUM};
    write_u8(&reply, STATUS_OK);
    const status_t status = execute(request, &reply);
    if (status != STATUS_OK && status != STATUS_NO_CYCLE_COUNTER) {
        reply.length = 1;
    }
    reply.bytes[0] = (uint8_t)status;
    const size_t length =
        message_finish(reply_body, request->type | REPLY_BIT, request->sequence, (uint16_t)reply.length);
    last.length = stuff(reply_body, length, last.wire);
    last.type = request->type;
    last.sequence = request->sequence;
    last.crc = request->crc;
}

static void handle_body(void)
{
    message_t request;
    if (!message_parse(unstuffer.body, unstuffer.length, &request)) {
        statistics.damaged++;
        return;
    }
    if ((request.type & REPLY_BIT) != 0u) {
        return; /* a reply, or our own bytes come back: not for us */
    }
    statistics.frames++;
    (void)uart_wait_until_sent(time_us() + SEND_TIMEOUT_US); /* the frame buffer is the one being sent */
    if (is_repeated(&request)) {
        statistics.repeated++;
    } else {
        answer(&request);
    }
    uart_send(last.wire, last.length);
    if (reset_requested) {
        (void)uart_wait_until_sent(time_us() + SEND_TIMEOUT_US);
        sleep_until_us(time_us() + uart_drain_us());
        board_reset();
    }
}

_Noreturn void server_run(void)
{
    for (;;) {
        const uart_span_t received = uart_wait_for_bytes();
        size_t taken;
        const unstuff_result_t result = unstuff(&unstuffer, received.bytes, received.count, &taken);
        uart_taken(taken); /* before the request is executed: what comes meanwhile has the whole buffer */
        if (result == UNSTUFF_BODY) {
            handle_body();
        } else if (result == UNSTUFF_DAMAGED) {
            statistics.damaged++;
        }
    }
}
