#include "direct_stream.h"

#include "closed_form.h"
#include "fast_code.h"

/* Not timed, so it need not be fast code. */
void direct_stream_reset(void *state, bool sliced)
{
    (void)sliced;
    *(direct_stream_t *)state = (direct_stream_t){0};
}

static inline bool fits(int32_t coordinate)
{
    return (uint32_t)(coordinate + EXACT_MOMENTS_LARGEST) <= 2u * EXACT_MOMENTS_LARGEST;
}

/* Add (sign 1) or take away (-1), unless the sums have no room for a coordinate. */
static inline __attribute__((always_inline)) stream_status_t step(direct_stream_t *stream, const int16_t point[3], int32_t sign)
{
    const int32_t x = point[0] - stream->anchor[0], y = point[1] - stream->anchor[1], z = point[2] - stream->anchor[2];
    if (!(fits(x) & fits(y) & fits(z))) { /* not &&: all six loads stand side by side then */
        return STREAM_OUT_OF_RANGE;
    }
    stream->held = (uint16_t)(stream->held + sign);
    exact_moments_accumulate(&stream->sums, x, y, z, sign);
    return STREAM_OK;
}

FAST_CODE stream_status_t direct_stream_add(void *state, const int16_t point[3])
{
    direct_stream_t *const stream = state;
    /* One comparison finds both rare cases: none held, which wraps, and all. */
    if (__builtin_expect(stream->held - 1u >= EXACT_MOMENTS_POINTS - 1u, 0)) {
        if (stream->held != 0u) {
            return STREAM_FULL;
        }
        stream->anchor[0] = point[0];
        stream->anchor[1] = point[1];
        stream->anchor[2] = point[2];
    }
    return step(stream, point, 1);
}

FAST_CODE stream_status_t direct_stream_remove(void *state, const int16_t point[3])
{
    direct_stream_t *const stream = state;
    return stream->held == 0u ? STREAM_EMPTY : step(stream, point, -1);
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
