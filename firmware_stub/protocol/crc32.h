/**
 * @file crc32.h
 * @brief CRC-32 of IEEE 802.3 (reflected 0x04C11DB7, start and final XOR 0xFFFFFFFF), the one zlib computes.
 */
#ifndef HILTEST_CRC32_H
#define HILTEST_CRC32_H

#include <stddef.h>
#include <stdint.h>

/** CRC-32 of `count` bytes; 0xCBF43926 for the nine bytes "123456789". */
uint32_t crc32(const uint8_t *bytes, size_t count);

#endif
