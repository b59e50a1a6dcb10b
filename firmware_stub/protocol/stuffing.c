#include "stuffing.h"

#include <string.h>

#define DELIMITER STUFFING_DELIMITER
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

static unstuff_result_t take_byte(unstuffer_t *state, uint8_t byte)
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

static inline bool is_special(uint8_t byte)
{
    return byte == DELIMITER || byte == ESCAPE;
}

/** Whether one of four bytes is; without a branch for each. */
static inline bool has_special(const uint8_t four[4])
{
    return is_special(four[0]) | is_special(four[1]) | is_special(four[2]) | is_special(four[3]);
}

/** Take what stands before the next delimiter or escape, as take_byte() would inside a body; returns how many bytes that is. */
static size_t take_ordinary(unstuffer_t *state, const uint8_t *bytes, size_t count)
{
    uint8_t *const body = &state->body[state->length];
    const size_t room = BODY_MAXIMUM - state->length;
    const size_t most = count < room ? count : room;
    size_t taken = 0;
    while (most - taken >= 4u && !has_special(&bytes[taken])) {
        memcpy(&body[taken], &bytes[taken], 4u);
        taken += 4u;
    }
    while (taken < most && !is_special(bytes[taken])) {
        body[taken] = bytes[taken];
        taken++;
    }
    state->length += taken;
    return taken;
}

unstuff_result_t unstuff(unstuffer_t *state, const uint8_t *bytes, size_t count, size_t *taken)
{
    unstuff_result_t result = UNSTUFF_PENDING;
    size_t used = 0;
    while (used < count && result == UNSTUFF_PENDING) {
        if (!state->complete && !state->escaped) {
            used += take_ordinary(state, &bytes[used], count - used);
        }
        if (used < count) {
            result = take_byte(state, bytes[used++]);
        }
    }
    *taken = used;
    return result;
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
