#include "direct_stream.h"

#include "closed_form.h"
#include "fast_code.h"

/* Not timed, so it need not be fast code. */
void direct_stream_reset(void *state, bool sliced)
{
    (void)sliced;
    *(direct_stream_t *)state = (direct_stream_t){0};
}

/* Coordinates relative to the anchor; false when the sums have no room for one of them. */
static inline __attribute__((always_inline)) bool anchored(const direct_stream_t *stream, const int16_t point[3], int32_t d[3])
{
    bool fits = true;
    for (int axis = 0; axis < 3; axis++) {
        d[axis] = point[axis] - stream->anchor[axis];
        fits &= (uint32_t)(d[axis] + EXACT_MOMENTS_LARGEST) <= 2u * EXACT_MOMENTS_LARGEST;
    }
    return fits;
}

FAST_CODE stream_status_t direct_stream_add(void *state, const int16_t point[3])
{
    direct_stream_t *const stream = state;
    int32_t d[3];
    if (stream->held == 0u) {
        stream->anchor[0] = point[0];
        stream->anchor[1] = point[1];
        stream->anchor[2] = point[2];
    }
    if (stream->held == EXACT_MOMENTS_POINTS) {
        return STREAM_FULL;
    }
    if (!anchored(stream, point, d)) {
        return STREAM_OUT_OF_RANGE;
    }
    stream->held++;
    exact_moments_add(&stream->sums, d[0], d[1], d[2]);
    return STREAM_OK;
}

FAST_CODE stream_status_t direct_stream_remove(void *state, const int16_t point[3])
{
    direct_stream_t *const stream = state;
    int32_t d[3];
    if (stream->held == 0u) {
        return STREAM_EMPTY;
    }
    if (!anchored(stream, point, d)) {
        return STREAM_OUT_OF_RANGE;
    }
    stream->held--;
    exact_moments_remove(&stream->sums, d[0], d[1], d[2]);
    return STREAM_OK;
}

FAST_CODE void direct_stream_report(void *state, stream_report_t *report)
{
    const direct_stream_t *const stream = state;
    report->held = stream->held;
    report->elements = 0;
    report->is_solving = false;
    report->accepted = 0;
    report->fit_error_percent = -1.0f;
    report->fit.iterations = 0;
    report->fit.coverage = 0.0f;
    if (stream->held < FIT_ELLIPSOID_UNKNOWNS) {
        fit_nothing(FIT_TOO_FEW_POINTS, &report->fit);
        return;
    }
    moments_t sums;
    int32_t origin[3];
    exact_moments_about_mean(&stream->sums, stream->held, origin, &sums);
    for (int axis = 0; axis < 3; axis++) {
        origin[axis] += stream->anchor[axis];
    }
    fit_closed_form(&sums, origin, &report->fit);
}
