/**
 * @file uart.h
 * @brief The serial port that the host is on. Interrupt-driven both ways.
 */
#ifndef HILTEST_UART_H
#define HILTEST_UART_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/** Take up to `capacity` received bytes; returns how many there were. */
size_t uart_read(uint8_t *bytes, size_t capacity);

/** Sleep until a received byte waits (true) or the deadline [us] passes (false). */
bool uart_wait_for_bytes(uint64_t deadline_us);

/** Start sending. `bytes` must stay unchanged, and no other send may start, until uart_wait_until_sent() is true. */
void uart_send(const uint8_t *bytes, size_t count);

/** Sleep until all bytes were handed to the transmitter (true) or the deadline [us] passes (false). */
bool uart_wait_until_sent(uint64_t deadline_us);

/** Time [us] the transmitter may still need for bytes it was handed before uart_wait_until_sent() became true. */
uint32_t uart_drain_us(void);

/** Receive errors since start: bytes lost in the receiver, framing errors, bytes that found the buffer full. */
uint32_t uart_overruns(void);

#endif
