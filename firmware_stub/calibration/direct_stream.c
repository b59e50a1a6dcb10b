#include "direct_stream.h"

#include "closed_form.h"
#include "fast_code.h"

/* Not timed, so it need not be fast code. */
void direct_stream_reset(void *state, bool sliced)
{
    (void)sliced;
    *(direct_stream_t *)state = (direct_stream_t){0};
}

/* Add (sign 1) or take away (-1), unless the sums have no room for a coordinate. Differences of counts are below 2^16, so their
 * squares fit 32 bits, and those of 2048 on have a bit above the 22nd: one comparison finds any. */
static inline __attribute__((always_inline)) stream_status_t step(direct_stream_t *stream, const int16_t point[3], int32_t sign)
{
    const int32_t x = sign * (point[0] - stream->anchor[0]), y = sign * (point[1] - stream->anchor[1]);
    const int32_t z = sign * (point[2] - stream->anchor[2]);
    const uint32_t xx = (uint32_t)x * (uint32_t)x, yy = (uint32_t)y * (uint32_t)y, zz = (uint32_t)z * (uint32_t)z;
    if (((xx | yy | zz) >> (2 * EXACT_MOMENTS_BITS)) != 0u) {
        return STREAM_OUT_OF_RANGE;
    }
    stream->held = (uint16_t)(stream->held + sign);
    exact_moments_accumulate(&stream->sums, x, y, z, (int32_t)xx, (int32_t)yy, (int32_t)zz, sign);
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
