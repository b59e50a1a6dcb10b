/**
 * @file stuffing.h
 * @brief Byte stuffing with 0x7E as delimiter and 0x7D as escape: where a body of bytes starts and ends on the wire.
 *
 * On the wire a frame is 0x7E body 0x7E, and in the body 0x7E becomes 7D 5E and 0x7D becomes 7D 5D. One delimiter may end a frame
 * and start the next; an empty body means nothing. The layer above defines the body.
 */
#ifndef HILTEST_STUFFING_H
#define HILTEST_STUFFING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/** Stands before and behind every body, and nowhere else. */
#define STUFFING_DELIMITER 0x7Eu

/** Longest body [bytes]: a message with 1024 bytes of payload. */
#define BODY_MAXIMUM 1032u
/** Longest frame on the wire [bytes]: every byte of the body escaped, and two delimiters. */
#define WIRE_MAXIMUM (2u * BODY_MAXIMUM + 2u)

typedef enum {
    UNSTUFF_PENDING = 0, /**< nothing complete yet */
    UNSTUFF_BODY,        /**< a body is complete in `body[0..length)`, until the next bytes are given */
    UNSTUFF_DAMAGED,     /**< what just ended cannot be a frame: too long, or an escape of something else */
} unstuff_result_t;

/** Receiver state; all zero is the start. */
typedef struct {
    uint8_t body[BODY_MAXIMUM];
    size_t length;
    bool escaped;
    bool damaged;
    bool complete;
} unstuffer_t;

/**
 * Take bytes from the wire, however they are cut, up to the end of a body or of what cannot be one.
 *
 * @param state what was given before
 * @param bytes from the wire
 * @param count of them
 * @param[out] taken how many were used: all of them when nothing is complete yet
 */
unstuff_result_t unstuff(unstuffer_t *state, const uint8_t *bytes, size_t count, size_t *taken);

/**
 * Put a body on the wire.
 *
 * @param body what to send, at most BODY_MAXIMUM bytes
 * @param length of the body
 * @param[out] wire room for WIRE_MAXIMUM bytes
 * @return bytes on the wire, delimiters included
 */
size_t stuff(const uint8_t *body, size_t length, uint8_t *wire);

#endif
