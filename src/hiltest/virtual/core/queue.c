#include "queue.h"

#include <stdlib.h>
#include <string.h>

enum { SMALLEST_CAPACITY = 256 };

/* Have the bytes lie at the beginning of the memory. */
static void align(struct queue *queue)
{
    if (queue->begin && queue->count)
        memmove(queue->bytes, queue->bytes + queue->begin, (size_t)queue->count);
    queue->begin = 0;
}

/* The memory is at least twice as large as needed: as many bytes are taken as moved before they are moved again. */
bool queue_reserve(struct queue *queue, int32_t count)
{
    if (count > QUEUE_LIMIT - queue->count)
        return false;
    int32_t least = 2 * (queue->count + count);
    if (queue->capacity >= least)
        return true;
    align(queue);
    int32_t capacity = 2 * least > SMALLEST_CAPACITY ? 2 * least : SMALLEST_CAPACITY;
    uint8_t *bytes = realloc(queue->bytes, (size_t)capacity);
    if (!bytes)
        return false;
    queue->bytes = bytes;
    queue->capacity = capacity;
    return true;
}

bool queue_put(struct queue *queue, uint8_t byte)
{
    if (queue->count == queue->capacity)
        return false;
    if (queue->begin + queue->count == queue->capacity)
        align(queue);
    queue->bytes[queue->begin + queue->count++] = byte;
    return true;
}

int32_t queue_take(struct queue *queue, uint8_t *bytes, int32_t count)
{
    int32_t taken = count < queue->count ? count : queue->count;
    if (taken <= 0)
        return 0;
    memcpy(bytes, queue->bytes + queue->begin, (size_t)taken);
    queue->begin += taken;
    queue->count -= taken;
    if (!queue->count)
        queue->begin = 0;
    return taken;
}

void queue_clear(struct queue *queue)
{
    queue->begin = queue->count = 0;
}

void queue_destroy(struct queue *queue)
{
    free(queue->bytes);
}
