/**
 * @file store.c
 * @brief The calibration in sector 7 of the flash, the last 128 KiB.
 *
 * The core stalls while the flash is erased, for 1 to 2 s at 2.7 V and more, because its code is in the same flash (RM0383, section
 * 3.5); samples of that time are lost. So it is done when a line asks for it, and never otherwise.
 */
#include "store.h"

#include <string.h>

#include "protocol/crc32.h"
#include "registers.h"

#define SECTOR 7u
#define MARKER 0x4E4F5249u /* "IRON" */
/* A look at SR waits for the flash itself while code runs from it; 2 s are 200 million cycles, and a look takes at least 4. */
#define MAXIMUM_LOOKS 50000000u

/** Bytes in flash; the check is over the calibration. */
typedef struct {
    uint32_t marker;
    iron_t iron;
    uint32_t check;
} stored_t;

extern const stored_t store_begin; /* of the linker script */

static uint32_t check_of(const iron_t *iron)
{
    return crc32((const uint8_t *)iron, sizeof *iron);
}

bool store_load(iron_t *iron)
{
    if (store_begin.marker != MARKER || store_begin.check != check_of(&store_begin.iron)) {
        return false;
    }
    *iron = store_begin.iron;
    return true;
}

/** Wait until the flash is idle; false when it found an error, or is busy for too long. */
static bool finish(void)
{
    for (uint32_t looks = 0; looks < MAXIMUM_LOOKS; looks++) {
        const uint32_t status = FLASH_SR;
        if ((status & FLASH_SR_BSY) == 0u) {
            FLASH_SR = FLASH_SR_EOP | FLASH_SR_ERRORS; /* written ones clear */
            return (status & FLASH_SR_ERRORS) == 0u;
        }
    }
    return false;
}

static bool erase(void)
{
    FLASH_CR = FLASH_CR_PSIZE_WORD | FLASH_CR_SER | FLASH_CR_SNB(SECTOR);
    FLASH_CR |= FLASH_CR_STRT;
    return finish();
}

static bool program(const stored_t *record)
{
    const uint32_t *const words = (const uint32_t *)record;
    volatile uint32_t *const flash = (volatile uint32_t *)(uintptr_t)&store_begin;
    FLASH_CR = FLASH_CR_PSIZE_WORD | FLASH_CR_PG;
    for (uint32_t i = 0; i < sizeof *record / sizeof *words; i++) {
        flash[i] = words[i];
        if (!finish()) {
            return false;
        }
    }
    return true;
}

bool store_save(const iron_t *iron)
{
    const stored_t record = {.marker = MARKER, .iron = *iron, .check = check_of(iron)};
    if ((FLASH_CR & FLASH_CR_LOCK) != 0u) {
        FLASH_KEYR = FLASH_KEY1;
        FLASH_KEYR = FLASH_KEY2;
    }
    const bool is_written = finish() && erase() && program(&record);
    FLASH_CR = FLASH_CR_LOCK;
    /* The data cache may hold lines from before; it is reset while it is off. */
    FLASH_ACR &= ~FLASH_ACR_DCEN;
    FLASH_ACR |= FLASH_ACR_DCRST;
    FLASH_ACR &= ~FLASH_ACR_DCRST;
    FLASH_ACR |= FLASH_ACR_DCEN;
    return is_written && memcmp(&store_begin, &record, sizeof record) == 0;
}
