#include "fast_code.h"
#include "stream_calibrator.h"

FAST_CODE stream_status_t empty_stream_add(void *state, const int16_t point[3])
{
    (void)state;
    (void)point;
    return STREAM_OK;
}

FAST_CODE void empty_stream_report(void *state, stream_report_t *report)
{
    (void)state;
    (void)report;
}
