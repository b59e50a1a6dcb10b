/**
 * @file payload.h
 * @brief Reading and writing the fields of a payload: little-endian, IEEE 754 floats, strings as length and bytes.
 *
 * Both ends remember the first thing that did not fit, so a handler reads or writes all its fields and asks once.
 */
#ifndef HILTEST_PAYLOAD_H
#define HILTEST_PAYLOAD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    const uint8_t *bytes;
    size_t length;
    size_t position;
    bool failed; /**< more was read than there is */
} payload_reader_t;

typedef struct {
    uint8_t *bytes;
    size_t capacity;
    size_t length;
    bool failed; /**< more was written than fits */
} payload_writer_t;

uint8_t read_u8(payload_reader_t *reader);
uint16_t read_u16(payload_reader_t *reader);
uint32_t read_u32(payload_reader_t *reader);
float read_f32(payload_reader_t *reader);

/** Read three int16, as every sensor vector is. */
void read_vector_i16(payload_reader_t *reader, int16_t vector[3]);

/** The next `count` bytes as they stand in the payload; NULL when there are not as many. */
const uint8_t *read_bytes(payload_reader_t *reader, size_t count);

/** Three int16 of such bytes. */
static inline void vector_i16_of(const uint8_t bytes[6], int16_t vector[3])
{
#pragma GCC unroll 3
    for (size_t axis = 0; axis < 3u; axis++) {
        vector[axis] = (int16_t)(uint16_t)(bytes[2u * axis] | bytes[2u * axis + 1u] << 8);
    }
}

/** A string's bytes, not terminated; `length` gets their number. Empty when it does not fit. */
const char *read_string(payload_reader_t *reader, uint8_t *length);

/** True when every byte was read and none too many. */
bool reader_is_exhausted(const payload_reader_t *reader);

void write_u8(payload_writer_t *writer, uint8_t value);
void write_u16(payload_writer_t *writer, uint16_t value);
void write_u32(payload_writer_t *writer, uint32_t value);
void write_u64(payload_writer_t *writer, uint64_t value);
void write_i8(payload_writer_t *writer, int8_t value);
void write_i16(payload_writer_t *writer, int16_t value);
void write_f32(payload_writer_t *writer, float value);

/** Write three int16, as every sensor vector is. */
void write_vector_i16(payload_writer_t *writer, const int16_t vector[3]);

/** Write `count` floats. */
void write_f32_array(payload_writer_t *writer, const float *values, size_t count);

/** Write a zero-terminated string of at most 255 bytes. */
void write_string(payload_writer_t *writer, const char *text);

#endif
