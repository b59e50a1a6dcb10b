#include "stream_set.h"

#include <stddef.h>
#include <string.h>

#include "calibration/stream_table.h"

#define STATE(name, prefix, removing) static prefix##_t prefix##_state;
STREAM_TABLE(STATE)

#define CAN_REMOVE(prefix) prefix##_remove
#define ADD_ONLY(prefix) NULL
#define ENTRY(name, prefix, removing) \
    {name, &prefix##_state, prefix##_reset, prefix##_add, removing(prefix), prefix##_report},

static const stream_calibrator_t streams[] = {STREAM_TABLE(ENTRY)};

uint8_t stream_set_count(void)
{
    return sizeof streams / sizeof streams[0];
}

const stream_calibrator_t *stream_set_get(uint8_t index)
{
    return &streams[index];
}

const stream_calibrator_t *stream_set_find(const char *name, uint8_t length)
{
    for (size_t i = 0; i < sizeof streams / sizeof streams[0]; i++) {
        if (strlen(streams[i].name) == length && memcmp(streams[i].name, name, length) == 0) {
            return &streams[i];
        }
    }
    return NULL;
}
