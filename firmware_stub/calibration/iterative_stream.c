#include "iterative_stream.h"

#include "fast_code.h"
#include "fit_result.h"

#define LOOPS_PER_SECOND 25.0f
#define AGEING_S 86400.0f
#define POWER_ON_FIT_ERROR_PERCENT 1000.0f

/* A solver of more elements is taken over with a larger fit error than the present one's, up to this. */
#define GOOD_FIT_ERROR_PERCENT 4.0f

/* Calibrated vectors are sorted as whole counts of a field of 50 uT. */
#define SORTING_COUNTS 500.0f

void iterative_stream_reset(void *state, bool sliced)
{
    *(iterative_stream_t *)state = (iterative_stream_t){.is_sliced = sliced};
}

/* -- sorting -------------------------------------------------------------------------------------------------------------- */

static inline __attribute__((always_inline)) int32_t calibrated(const float row[3], const float d[3])
{
    return (int32_t)(SORTING_COUNTS * (row[0] * d[0] + row[1] * d[1] + row[2] * d[2]));
}

static FAST_CODE int32_t cell_of(const iterative_stream_t *stream, const int16_t point[3])
{
    if (stream->elements == 0u) {
        return magnetic_buffer_cell(point[0], point[1], point[2]);
    }
    const float *const soft_iron = stream->calibration.soft_iron, *const hard_iron = stream->calibration.hard_iron;
    const float d[3] = {(float)point[0] - hard_iron[0], (float)point[1] - hard_iron[1], (float)point[2] - hard_iron[2]};
    return magnetic_buffer_cell(calibrated(&soft_iron[0], d), calibrated(&soft_iron[3], d), calibrated(&soft_iron[6], d));
}

/* -- solving -------------------------------------------------------------------------------------------------------------- */

/* Elements of the solver that is due, 0 when none is. */
static FAST_CODE uint8_t due(const iterative_stream_t *stream)
{
    const uint16_t held = stream->buffer.held;
    const uint8_t elements = held >= 250u ? 10u : held >= 150u ? 7u : held >= 100u ? 4u : 0u;
    if (elements > stream->highest) {
        return elements;
    }
    const uint32_t interval = elements == 10u ? 750u : elements == 7u ? 250u : 75u;
    return stream->loops - stream->started >= interval ? elements : 0u;
}

static FAST_CODE void sum_cells(iterative_stream_t *stream, int32_t first, int32_t count)
{
    solver_t *const solver = &stream->solver;
    magnetometer_points_t points = {.points = (const int16_t(*)[3])stream->gathered};
    points.count = magnetic_buffer_gather(&stream->buffer, first, count, stream->gathered);
    if (points.count > 0u) {
        moments_t part;
        moments_sum(&points, solver->anchor, &part);
        moments_merge(&solver->sums, &part);
    }
}

static FAST_CODE void start(iterative_stream_t *stream, uint8_t elements)
{
    solver_t *const solver = &stream->solver;
    const float age_s = (float)(stream->loops - stream->started) / LOOPS_PER_SECOND;
    stream->calibration.fit_error_percent *= 1.0f + age_s / AGEING_S;
    stream->started = stream->loops;
    stream->highest = elements;
    solver->elements = elements;
    solver->sweeps = 0;
    solver->next_cell = 0;
    solver->work = WORK_SUMS;
    magnetometer_points_t range = {.count = 0};
    magnetic_buffer_range(&stream->buffer, range.minimum, range.maximum);
    moments_anchor(&range, solver->anchor);
    moments_sum(&range, solver->anchor, &solver->sums); /* of no points: zeros */
}

static FAST_CODE void set_up(solver_t *solver)
{
    element_fit_matrix(&solver->sums, solver->elements, &solver->matrix);
    solver->negligible = jacobi_start(&solver->matrix, solver->elements);
    solver->row = 0;
    solver->column = 1;
    solver->has_rotated = false;
}

static inline bool is_better(const iterative_stream_t *stream, const trial_t *trial)
{
    return stream->elements == 0u || trial->fit_error_percent <= stream->calibration.fit_error_percent ||
           (stream->solver.elements > stream->elements && trial->fit_error_percent <= GOOD_FIT_ERROR_PERCENT);
}

static FAST_CODE void calibrate(iterative_stream_t *stream)
{
    solver_t *const solver = &stream->solver;
    trial_t trial;
    const bool is_fit = solver->elements == 4u ? element_fit_4(&solver->sums, solver->anchor, &trial)
                                               : element_fit_from_matrix(&solver->matrix, solver->elements, solver->sums.one,
                                                                         solver->anchor, &trial);
    solver->work = WORK_NONE;
    if (is_fit && solver->sweeps < JACOBI_SWEEP_LIMIT && is_better(stream, &trial)) {
        for (int i = 0; i < 9; i++) {
            stream->calibration.soft_iron[i] = trial.soft_iron[i];
        }
        for (int axis = 0; axis < 3; axis++) {
            stream->calibration.hard_iron[axis] = trial.hard_iron[axis];
        }
        stream->calibration.fit_error_percent = trial.fit_error_percent;
        stream->elements = solver->elements;
        stream->sweeps = solver->sweeps;
        stream->accepted++;
    }
}

static FAST_CODE void solve_at_once(iterative_stream_t *stream)
{
    solver_t *const solver = &stream->solver;
    sum_cells(stream, 0, MAGNETIC_BUFFER_CELLS);
    if (solver->elements > 4u) {
        element_fit_matrix(&solver->sums, solver->elements, &solver->matrix);
        solver->sweeps = jacobi_diagonalise(&solver->matrix, solver->elements, JACOBI_SWEEP_LIMIT);
    }
    calibrate(stream);
}

/* -- slices --------------------------------------------------------------------------------------------------------------- */

static FAST_CODE void slice_sums(iterative_stream_t *stream)
{
    solver_t *const solver = &stream->solver;
    const int32_t count = solver->elements == 4u ? MAGNETIC_BUFFER_ROW_CELLS : 1;
    sum_cells(stream, solver->next_cell, count);
    solver->next_cell += count;
    if (solver->next_cell == MAGNETIC_BUFFER_CELLS) {
        solver->work = solver->elements == 4u ? WORK_CALIBRATION : WORK_SET_UP;
    }
}

static FAST_CODE void slice_rotation(solver_t *solver)
{
    const uint8_t size = solver->elements;
    solver->has_rotated |= jacobi_rotate(&solver->matrix, size, solver->row, solver->column, solver->negligible);
    solver->column++;
    if (solver->column == size) {
        solver->row++;
        solver->column = (uint8_t)(solver->row + 1u);
    }
    solver->work = solver->column < size ? WORK_ROTATIONS : WORK_RESIDUE;
}

static FAST_CODE void slice_residue(solver_t *solver)
{
    const bool goes_on = solver->has_rotated;
    solver->sweeps = (uint16_t)(solver->sweeps + (goes_on ? 1u : 0u));
    solver->row = 0;
    solver->column = 1;
    solver->has_rotated = false;
    solver->work = goes_on && solver->sweeps < JACOBI_SWEEP_LIMIT ? WORK_ROTATIONS : WORK_CALIBRATION;
}

static FAST_CODE void slice(iterative_stream_t *stream)
{
    solver_t *const solver = &stream->solver;
    switch (solver->work) {
    case WORK_SUMS:
        slice_sums(stream);
        break;
    case WORK_SET_UP:
        set_up(solver);
        solver->work = WORK_ROTATIONS;
        break;
    case WORK_ROTATIONS:
        slice_rotation(solver);
        break;
    case WORK_RESIDUE:
        slice_residue(solver);
        break;
    case WORK_CALIBRATION:
        calibrate(stream);
        break;
    case WORK_NONE:
        break;
    }
}

/* -- one loop ------------------------------------------------------------------------------------------------------------- */

FAST_CODE stream_status_t iterative_stream_add(void *state, const int16_t point[3])
{
    iterative_stream_t *const stream = state;
    solver_t *const solver = &stream->solver;
    stream->loops++;
    if (solver->work != WORK_SUMS) {
        const int32_t cell = cell_of(stream, point);
        if (cell != MAGNETIC_BUFFER_NO_CELL) {
            magnetic_buffer_store(&stream->buffer, cell, point, stream->loops);
        }
    }
    if (solver->work != WORK_NONE) {
        slice(stream);
        return STREAM_OK;
    }
    const uint8_t elements = due(stream);
    if (elements != 0u) {
        start(stream, elements);
        if (!stream->is_sliced) {
            solve_at_once(stream);
        }
    }
    return STREAM_OK;
}

FAST_CODE void iterative_stream_report(void *state, stream_report_t *report)
{
    const iterative_stream_t *const stream = state;
    report->held = stream->buffer.held;
    report->elements = stream->elements;
    report->is_solving = stream->solver.work != WORK_NONE;
    report->accepted = stream->accepted;
    report->fit_error_percent = POWER_ON_FIT_ERROR_PERCENT;
    report->fit.iterations = stream->sweeps;
    report->fit.coverage = 0.0f;
    if (stream->elements == 0u) {
        fit_nothing(stream->highest == 0u ? FIT_TOO_FEW_POINTS : FIT_SINGULAR, &report->fit);
        return;
    }
    report->fit_error_percent = stream->calibration.fit_error_percent;
    report->fit.status = FIT_ELLIPSOID;
    report->fit.is_sphere = stream->elements == 4u ? 1u : 0u;
    for (int i = 0; i < 9; i++) {
        report->fit.soft_iron[i] = stream->calibration.soft_iron[i];
    }
    for (int axis = 0; axis < 3; axis++) {
        report->fit.hard_iron[axis] = stream->calibration.hard_iron[axis];
    }
}
