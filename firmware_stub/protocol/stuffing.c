#include "stuffing.h"

#define DELIMITER 0x7Eu
#define ESCAPE 0x7Du
#define ESCAPED_DELIMITER 0x5Eu
#define ESCAPED_ESCAPE 0x5Du

/** A delimiter ends whatever there was and starts the next body. */
static unstuff_result_t end_of_frame(unstuffer_t *state)
{
    const bool damaged = state->damaged || state->escaped;
    const bool empty = state->length == 0u;
    state->escaped = false;
    state->damaged = false;
    state->complete = true;
    if (damaged) {
        return UNSTUFF_DAMAGED;
    }
    return empty ? UNSTUFF_PENDING : UNSTUFF_BODY;
}

unstuff_result_t unstuff(unstuffer_t *state, uint8_t byte)
{
    if (state->complete) {
        state->complete = false;
        state->length = 0;
    }
    if (byte == DELIMITER) {
        return end_of_frame(state);
    }
    if (state->escaped) {
        state->escaped = false;
        state->damaged = state->damaged || (byte != ESCAPED_DELIMITER && byte != ESCAPED_ESCAPE);
        byte = byte == ESCAPED_DELIMITER ? DELIMITER : ESCAPE;
    } else if (byte == ESCAPE) {
        state->escaped = true;
        return UNSTUFF_PENDING;
    }
    if (state->length < BODY_MAXIMUM) {
        state->body[state->length++] = byte;
    } else {
        state->damaged = true;
    }
    return UNSTUFF_PENDING;
}

size_t stuff(const uint8_t *body, size_t length, uint8_t *wire)
{
    size_t count = 0;
    wire[count++] = DELIMITER;
    for (size_t i = 0; i < length; i++) {
        if (body[i] == DELIMITER || body[i] == ESCAPE) {
            wire[count++] = ESCAPE;
            wire[count++] = body[i] == DELIMITER ? ESCAPED_DELIMITER : ESCAPED_ESCAPE;
        } else {
            wire[count++] = body[i];
        }
    }
    wire[count++] = DELIMITER;
    return count;
}
