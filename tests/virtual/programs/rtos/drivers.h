/* UART with ring buffers, I2C, and a timer: all by interrupt. */
#ifndef RTOS_DRIVERS_H
#define RTOS_DRIVERS_H

#include <stdbool.h>
#include <stdint.h>

void clock_start(void); /* 120 MHz */

void uart_start(void);
bool uart_get(uint8_t *byte); /* false: nothing has arrived */
bool uart_put(uint8_t byte);  /* false: no room */

void i2c_start(void);
void i2c_read_register(uint8_t address, uint8_t number);
bool i2c_answer(uint8_t *value); /* false: not yet */

void timer_start(void);

#endif
