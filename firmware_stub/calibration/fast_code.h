/**
 * @file fast_code.h
 * @brief Where a calibrator's instructions live, and how.
 *
 * On the target the section is copied to SRAM_L at start-up: straight-line floating-point code from flash would be bound by
 * instruction fetch, and cycle counts would measure the flash cache. On a host the mark means nothing.
 *
 * place.py puts its 32-bit instructions at words where 16-bit ones before them can be widened.
 */
#ifndef HILTEST_FAST_CODE_H
#define HILTEST_FAST_CODE_H

#if defined(__arm__)
#define FAST_CODE __attribute__((section(".fast_code")))
#else
#define FAST_CODE
#endif

#include <stdbool.h>
#include <stdint.h>

/**
 * @brief Sign of a float by its bit: true for -0, too.
 *
 * A compare of integers and the IT behind it have 16 bits each; one of floats, and its flags, 32 each: an IT behind those moves all
 * that follows by half a word.
 *
 * @param value Any float.
 * @return Whether it has a minus.
 */
static inline __attribute__((always_inline)) bool has_minus(float value)
{
    int32_t bits;
    __builtin_memcpy(&bits, &value, sizeof bits);
    return bits < 0;
}

#endif
