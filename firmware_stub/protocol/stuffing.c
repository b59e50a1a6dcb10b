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

#define IN_EVERY_BYTE(value) ((value) * 0x01010101u)

/** The highest bit of every zero byte; of other bytes only behind a zero byte, so that the lowest bit set is right. */
static inline uint32_t zero_bytes(uint32_t word)
{
    return (word - IN_EVERY_BYTE(1u)) & ~word & IN_EVERY_BYTE(0x80u);
}

/** Not 0 when one of four bytes must be escaped on the wire; its lowest bit is in the first that is. */
static inline uint32_t special_bytes(uint32_t word)
{
    return zero_bytes(word ^ IN_EVERY_BYTE(DELIMITER)) | zero_bytes(word ^ IN_EVERY_BYTE(ESCAPE));
}

static inline bool is_special(uint8_t byte)
{
    return byte == DELIMITER || byte == ESCAPE;
}

/** Copy the bytes before the first delimiter or escape; returns how many. May write up to `count` bytes whatever it returns. */
static size_t copy_ordinary(const uint8_t *from, size_t count, uint8_t *to)
{
    uint32_t special = 0;
    size_t copied = 0;
    for (; (special == 0u) & (count - copied >= 4u); copied += 4u) { /* one branch a word */
        uint32_t word;
        memcpy(&word, &from[copied], 4u);
        memcpy(&to[copied], &word, 4u);
        special = special_bytes(word);
    }
    if (special != 0u) {
        return copied - 4u + (size_t)__builtin_ctz(special) / 8u;
    }
    for (; copied < count && !is_special(from[copied]); copied++) {
        to[copied] = from[copied];
    }
    return copied;
}

/** Take what stands before the next delimiter or escape, as take_byte() would inside a body; returns how many bytes that is. */
static size_t take_ordinary(unstuffer_t *state, const uint8_t *bytes, size_t count)
{
    const size_t room = BODY_MAXIMUM - state->length;
    const size_t taken = copy_ordinary(bytes, count < room ? count : room, &state->body[state->length]);
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
    size_t count = 0, done = 0;
    wire[count++] = DELIMITER;
    while (done < length) {
        const size_t ordinary = copy_ordinary(&body[done], length - done, &wire[count]);
        done += ordinary;
        count += ordinary;
        if (done < length) {
            wire[count++] = ESCAPE;
            wire[count++] = body[done++] == DELIMITER ? ESCAPED_DELIMITER : ESCAPED_ESCAPE;
        }
    }
    wire[count++] = DELIMITER;
    return count;
}
