/**
 * @file uart.h
 * @brief The serial port that the host is on. Interrupt-driven both ways.
 */
#ifndef HILTEST_UART_H
#define HILTEST_UART_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/**
 * Received bytes are handed over up to the last of these that came. Bytes behind it wait for the next one, or until they
 * fill half of the buffer, so the main loop is not woken for a part of a frame, and a line that never ends a frame fills nothing.
 */
#define UART_LAST_BYTE 0x7Eu

/** Received bytes where they lie. */
typedef struct {
    const uint8_t *bytes;
    size_t count;
} uart_span_t;

/** Sleep until bytes were handed over; returns the first of them, at least one and as many as lie in one piece. */
uart_span_t uart_wait_for_bytes(void);

/** Give back the first `count` bytes of that span: received ones will take their place. */
void uart_taken(size_t count);

/** Start sending. `bytes` must stay unchanged, and no other send may start, until uart_wait_until_sent() is true. */
void uart_send(const uint8_t *bytes, size_t count);

/** Sleep until all bytes were handed to the transmitter (true) or the deadline [us] passes (false). */
bool uart_wait_until_sent(uint64_t deadline_us);

/** Time [us] the transmitter may still need for bytes it was handed before uart_wait_until_sent() became true. */
uint32_t uart_drain_us(void);

/** Receive errors since start: bytes lost in the receiver, framing errors, bytes that found the buffer full. */
uint32_t uart_overruns(void);

#endif
