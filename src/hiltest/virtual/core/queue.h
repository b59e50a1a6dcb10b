/* Bytes on their way between the host and a peripheral, first in, first out. */
#ifndef HILTEST_QUEUE_H
#define HILTEST_QUEUE_H

#include <stdbool.h>
#include <stdint.h>

enum { QUEUE_LIMIT = 1 << 24 };

/* All of it is zero at first. */
struct queue {
    uint8_t *bytes;
    int32_t begin, count, capacity;
};

/* Make room for so many more bytes. False if they would be more than QUEUE_LIMIT, or there is no memory. */
bool queue_reserve(struct queue *queue, int32_t count);
/* Put a byte at the end. False if there is no room that was reserved. */
bool queue_put(struct queue *queue, uint8_t byte);
/* Take at most so many bytes from the beginning; returns how many. */
int32_t queue_take(struct queue *queue, uint8_t *bytes, int32_t count);
/* Drop all bytes; the room stays. */
void queue_clear(struct queue *queue);
void queue_destroy(struct queue *queue);

#endif
