/**
 * @file instruction_sequences.h
 * @brief Short runs of one kind of instruction, to be timed: what a cycle model is made from.
 *
 * They reside in the firmware, once in SRAM_L and once in flash: nothing that comes over the line is ever executed. Each ends by
 * itself, and writes nothing but registers and a buffer of its own. A run that enters it in its middle has the same edges: what the
 * whole one takes longer is its first half's alone. Which body stands at which place of the list is said in PROTOCOL.md.
 */
#ifndef HILTEST_INSTRUCTION_SEQUENCES_H
#define HILTEST_INSTRUCTION_SEQUENCES_H

#include <stdint.h>

/** Where a sequence runs from. */
typedef enum {
    SEQUENCE_IN_SRAM = 0,         /**< SRAM_L, with its data in SRAM_U */
    SEQUENCE_IN_FLASH = 1,        /**< flash, with the cache and the buffers of its controller as reset leaves them */
    SEQUENCE_IN_FLASH_ALONE = 2,  /**< flash, with cache, prefetch and buffers of its controller switched off meanwhile */
    SEQUENCE_IN_FLASH_WITHOUT_CACHE = 3,
    SEQUENCE_IN_FLASH_WITHOUT_PREFETCH = 4,
    SEQUENCE_PLACES = 5
} sequence_place_t;

/** How many sequences there are. */
uint8_t sequence_count(void);

/**
 * Run a sequence without interrupts.
 *
 * @param sequence below sequence_count()
 * @param place where it runs from
 * @return core clock cycles with those of its edges
 */
uint32_t sequence_cycles(uint8_t sequence, sequence_place_t place);

/**
 * Run the second half of a sequence without interrupts.
 *
 * @param sequence below sequence_count()
 * @param place where it runs from
 * @return core clock cycles with those of the same edges
 */
uint32_t sequence_cycles_from_middle(uint8_t sequence, sequence_place_t place);

#endif
