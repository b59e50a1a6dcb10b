/**
 * @file interrupt_mask.h
 * @brief PRIMASK without a function call, for code of this board.
 */
#ifndef HILTEST_INTERRUPT_MASK_H
#define HILTEST_INTERRUPT_MASK_H

#include <stdint.h>

static inline uint32_t primask_set(void)
{
    uint32_t mask;
    __asm volatile("mrs %0, primask\n\tcpsid i" : "=r"(mask)::"memory");
    return mask;
}

static inline void primask_restore(uint32_t mask)
{
    __asm volatile("msr primask, %0" ::"r"(mask) : "memory");
}

#endif
