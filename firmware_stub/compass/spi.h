/** @file spi.h @brief Register reads and writes on an SPI bus with one device. */
#ifndef COMPASS_SPI_H
#define COMPASS_SPI_H

#include <stdbool.h>
#include <stdint.h>

/** Send a first byte, and exchange `count` bytes after it. `out` is NULL for zeros, `in` is NULL if nothing is kept. False after a timeout. */
bool spi_transfer(uint8_t first, const uint8_t *out, uint8_t *in, uint32_t count);

#endif
