/**
 * @file fast_code.h
 * @brief Where a calibrator's instructions live.
 *
 * On the target the section is copied to SRAM_L at start-up: straight-line floating-point code from flash would be bound by
 * instruction fetch, and cycle counts would measure the flash cache. On a host the mark means nothing.
 */
#ifndef HILTEST_FAST_CODE_H
#define HILTEST_FAST_CODE_H

#if defined(__arm__)
#define FAST_CODE __attribute__((section(".fast_code")))
#else
#define FAST_CODE
#endif

#endif
