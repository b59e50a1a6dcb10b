#include "payload.h"

#include <string.h>

static inline __attribute__((always_inline)) uint64_t read_unsigned(payload_reader_t *reader, size_t size)
{
    if (reader->failed || reader->length - reader->position < size) {
        reader->failed = true;
        return 0;
    }
    uint64_t value = 0;
#pragma GCC unroll 8 /* callers give a constant: no loop is left */
    for (size_t i = size; i > 0u; i--) {
        value = value << 8 | reader->bytes[reader->position + i - 1u];
    }
    reader->position += size;
    return value;
}

uint8_t read_u8(payload_reader_t *reader)
{
    return (uint8_t)read_unsigned(reader, 1);
}

uint16_t read_u16(payload_reader_t *reader)
{
    return (uint16_t)read_unsigned(reader, 2);
}

uint32_t read_u32(payload_reader_t *reader)
{
    return (uint32_t)read_unsigned(reader, 4);
}

void read_vector_i16(payload_reader_t *reader, int16_t vector[3])
{
    const uint64_t bits = read_unsigned(reader, 6);
    for (size_t axis = 0; axis < 3u; axis++) {
        vector[axis] = (int16_t)(uint16_t)(bits >> (16u * axis));
    }
}

float read_f32(payload_reader_t *reader)
{
    const uint32_t bits = read_u32(reader);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

const uint8_t *read_bytes(payload_reader_t *reader, size_t count)
{
    if (reader->failed || reader->length - reader->position < count) {
        reader->failed = true;
        return NULL;
    }
    const uint8_t *const bytes = &reader->bytes[reader->position];
    reader->position += count;
    return bytes;
}

const char *read_string(payload_reader_t *reader, uint8_t *length)
{
    *length = read_u8(reader);
    if (reader->failed || reader->length - reader->position < *length) {
        reader->failed = true;
        *length = 0;
        return "";
    }
    const char *text = (const char *)&reader->bytes[reader->position];
    reader->position += *length;
    return text;
}

bool reader_is_exhausted(const payload_reader_t *reader)
{
    return !reader->failed && reader->position == reader->length;
}

/** Room for more bytes; NULL when there is not as much. */
static inline uint8_t *take_room(payload_writer_t *writer, size_t size)
{
    if (writer->failed || writer->capacity - writer->length < size) {
        writer->failed = true;
        return NULL;
    }
    uint8_t *const bytes = &writer->bytes[writer->length];
    writer->length += size;
    return bytes;
}

static inline __attribute__((always_inline)) void put_unsigned(uint8_t *bytes, uint64_t value, size_t size)
{
#pragma GCC unroll 8 /* callers give a constant: no loop is left */
    for (size_t i = 0; i < size; i++) {
        bytes[i] = (uint8_t)(value >> (8u * i));
    }
}

static inline __attribute__((always_inline)) void write_unsigned(payload_writer_t *writer, uint64_t value, size_t size)
{
    uint8_t *const bytes = take_room(writer, size);
    if (bytes != NULL) {
        put_unsigned(bytes, value, size);
    }
}

void write_u8(payload_writer_t *writer, uint8_t value)
{
    write_unsigned(writer, value, 1);
}

void write_u16(payload_writer_t *writer, uint16_t value)
{
    write_unsigned(writer, value, 2);
}

void write_u32(payload_writer_t *writer, uint32_t value)
{
    write_unsigned(writer, value, 4);
}

void write_u64(payload_writer_t *writer, uint64_t value)
{
    write_unsigned(writer, value, 8);
}

void write_i8(payload_writer_t *writer, int8_t value)
{
    write_u8(writer, (uint8_t)value);
}

void write_i16(payload_writer_t *writer, int16_t value)
{
    write_u16(writer, (uint16_t)value);
}

static inline uint32_t bits_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

void write_f32(payload_writer_t *writer, float value)
{
    write_u32(writer, bits_of(value));
}

void write_vector_i16(payload_writer_t *writer, const int16_t vector[3])
{
    const uint64_t x = (uint16_t)vector[0], y = (uint16_t)vector[1], z = (uint16_t)vector[2];
    write_unsigned(writer, x | y << 16 | z << 32, 6);
}

void write_f32_array(payload_writer_t *writer, const float *values, size_t count)
{
    uint8_t *const bytes = take_room(writer, 4u * count);
    for (size_t i = 0; i < count && bytes != NULL; i++) {
        put_unsigned(&bytes[4u * i], bits_of(values[i]), 4);
    }
}

void write_string(payload_writer_t *writer, const char *text)
{
    const size_t length = strlen(text);
    if (length > UINT8_MAX) {
        writer->failed = true;
        return;
    }
    write_u8(writer, (uint8_t)length);
    uint8_t *const bytes = take_room(writer, length);
    if (bytes != NULL) {
        memcpy(bytes, text, length);
    }
}
