/**
 * @file message.h
 * @brief Requests and replies inside a frame's body: type, sequence, length, payload, CRC-32.
 */
#ifndef HILTEST_MESSAGE_H
#define HILTEST_MESSAGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "stuffing.h"

#define PROTOCOL_VERSION 9u
#define PAYLOAD_MAXIMUM 1024u
#define REPLY_BIT 0x80u

/** How a request ended: the first byte of every reply. */
typedef enum {
    STATUS_OK = 0,
    STATUS_UNKNOWN_COMMAND = 1,
    STATUS_BAD_LENGTH = 2,
    STATUS_BAD_ARGUMENT = 3,
    STATUS_NO_SUCH_SENSOR = 4,
    STATUS_SENSOR_ABSENT = 5,
    STATUS_SENSOR_TIMEOUT = 6,
    STATUS_BUS_ERROR = 7,
    STATUS_BUFFER_FULL = 8,
    STATUS_TOO_FEW_POINTS = 9,
    STATUS_UNKNOWN_CALIBRATOR = 10,
    STATUS_NO_CALIBRATION = 11,
    STATUS_NO_CYCLE_COUNTER = 12,
    STATUS_DEGENERATE_FIELD = 13,
    STATUS_BUSY = 14,
    STATUS_NOT_SUPPORTED = 15,
} status_t;

/** A message, its payload still in the body it was found in. */
typedef struct {
    uint8_t type;
    uint8_t sequence;
    const uint8_t *payload;
    uint16_t payload_length;
    uint32_t crc;
} message_t;

/** Find the message in a body. False when it is too short, its length field is wrong, or its CRC is. */
bool message_parse(const uint8_t *body, size_t length, message_t *message);

/** Where the payload goes in the body of a message that is being built. */
uint8_t *message_payload(uint8_t body[BODY_MAXIMUM]);

/** Complete a message whose payload is in place; returns the length of the body. */
size_t message_finish(uint8_t body[BODY_MAXIMUM], uint8_t type, uint8_t sequence, uint16_t payload_length);

#endif
