#include "message.h"

#include "crc32.h"
#include "payload.h"

#define HEADER_BYTES 4u
#define CRC_BYTES 4u

bool message_parse(const uint8_t *body, size_t length, message_t *message)
{
    if (length < HEADER_BYTES + CRC_BYTES) {
        return false;
    }
    payload_reader_t header = {.bytes = body, .length = length};
    message->type = read_u8(&header);
    message->sequence = read_u8(&header);
    message->payload_length = read_u16(&header);
    if (length != HEADER_BYTES + message->payload_length + CRC_BYTES) {
        return false;
    }
    message->payload = &body[HEADER_BYTES];
    payload_reader_t trailer = {.bytes = &body[length - CRC_BYTES], .length = CRC_BYTES};
    message->crc = read_u32(&trailer);
    return message->crc == crc32(body, length - CRC_BYTES);
}

uint8_t *message_payload(uint8_t body[BODY_MAXIMUM])
{
    return &body[HEADER_BYTES];
}

size_t message_finish(uint8_t body[BODY_MAXIMUM], uint8_t type, uint8_t sequence, uint16_t payload_length)
{
    payload_writer_t header = {.bytes = body, .capacity = HEADER_BYTES};
    write_u8(&header, type);
    write_u8(&header, sequence);
    write_u16(&header, payload_length);
    const size_t checked = HEADER_BYTES + (size_t)payload_length;
    payload_writer_t trailer = {.bytes = &body[checked], .capacity = CRC_BYTES};
    write_u32(&trailer, crc32(body, checked));
    return checked + CRC_BYTES;
}
