/* Two tasks, switched every tick and whenever one yields. */
#ifndef RTOS_KERNEL_H
#define RTOS_KERNEL_H

#include <stdint.h>

/* Run two tasks for ever; each has a stack of its own (PSP), interrupts share the main stack. */
_Noreturn void kernel_start(void (*first)(void), void (*second)(void));

/* Supervisor calls. */
uint32_t kernel_ticks(void);
void kernel_yield(void);

#endif
