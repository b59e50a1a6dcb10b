/** @file spi.c @brief SPI1 on PA5 to PA7 with the chip select PE3, mode 3 at 6.25 MHz: the gyroscope's. A byte takes 1.3 us, so it is polled. */
#include "spi.h"

#include "board_parts.h"
#include "registers.h"

#define CHIP_SELECT 3u
#define ALTERNATIVE 5u
#define MAXIMUM_LOOKS 1000u /* a byte takes 128 cycles; a look at least 4 */

static bool wait_for(uint32_t mask, uint32_t wanted)
{
    for (uint32_t looks = 0; looks < MAXIMUM_LOOKS; looks++) {
        if ((SPI1_SR & mask) == wanted) {
            return true;
        }
    }
    return false;
}

void spi_start(void)
{
    pin_set(GPIOE_BASE, CHIP_SELECT, 1u);
    pin_output(GPIOE_BASE, CHIP_SELECT);
    for (uint32_t pin = 5u; pin <= 7u; pin++) {
        pin_connect(GPIOA_BASE, pin, ALTERNATIVE);
        GPIO_OSPEEDR(GPIOA_BASE) |= GPIO_SPEED_MEDIUM << (2u * pin); /* the lowest speed ends at 4 MHz */
    }
    SPI1_CR1 = SPI_CR1_CPHA | SPI_CR1_CPOL | SPI_CR1_MSTR | SPI_CR1_DIV16 | SPI_CR1_SSI | SPI_CR1_SSM;
    SPI1_CR1 |= SPI_CR1_SPE;
}

/** Exchange a byte; false when the block does not answer in time. */
static bool exchange(uint8_t out, uint8_t *in)
{
    if (!wait_for(SPI_SR_TXE, SPI_SR_TXE)) {
        return false;
    }
    SPI1_DR = out;
    if (!wait_for(SPI_SR_RXNE, SPI_SR_RXNE)) {
        return false;
    }
    *in = SPI1_DR;
    return true;
}

bool spi_transfer(uint8_t first, const uint8_t *out, uint8_t *in, uint32_t count)
{
    uint8_t ignored;
    pin_set(GPIOE_BASE, CHIP_SELECT, 0u);
    bool is_done = exchange(first, &ignored);
    for (uint32_t i = 0; i < count && is_done; i++) {
        is_done = exchange(out != (const uint8_t *)0 ? out[i] : 0u, in != (uint8_t *)0 ? &in[i] : &ignored);
    }
    is_done = wait_for(SPI_SR_BSY, 0u) && is_done;
    pin_set(GPIOE_BASE, CHIP_SELECT, 1u);
    return is_done;
}
