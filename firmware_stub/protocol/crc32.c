#include "crc32.h"

#define STRAIGHT_BYTES 8u

/** Remainders of the 16 values of a nibble: 64 bytes of table instead of 1 KiB, at two steps a byte. */
static const uint32_t nibble_remainder[16] = {
    0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u, 0x4DB26158u, 0x5005713Cu,
    0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu, 0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
};

static inline uint32_t with_byte(uint32_t crc, uint8_t byte)
{
    crc ^= byte;
    crc = (crc >> 4) ^ nibble_remainder[crc & 0xFu];
    return (crc >> 4) ^ nibble_remainder[crc & 0xFu];
}

uint32_t crc32(const uint8_t *bytes, size_t count)
{
    uint32_t crc = 0xFFFFFFFFu;
    size_t done = 0;
    for (; count - done >= STRAIGHT_BYTES; done += STRAIGHT_BYTES) {
#pragma GCC unroll 8 /* none is left of this loop, which would cost as much as a byte */
        for (size_t i = 0; i < STRAIGHT_BYTES; i++) {
            crc = with_byte(crc, bytes[done + i]);
        }
    }
    for (; done < count; done++) {
        crc = with_byte(crc, bytes[done]);
    }
    return ~crc;
}
