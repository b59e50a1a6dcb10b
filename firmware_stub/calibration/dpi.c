/* The normal equations of the dot product, factored as L D L^T without pivoting, and from their solution to a calibration. */
#include "dpi.h"

#include "dpi_sums.h"
#include "fast_code.h"
#include "fit_result.h"
#include "gravity_equations.h"

#define UNKNOWNS GRAVITY_UNKNOWNS

/* The dot product must be this many of its standard errors: below, noise and not the dip makes the fit's scale. */
#define SIGNIFICANCE 5.0f

/* Times the pivot that attitudes all round would have. 300 pairs of a tumble give 6; tilts of 30 degrees at most 38, with headings
 * that err by 1.6 degrees; of 20 degrees 140 and 6.5; pairs that never tilt 1e6 and more. */
#define COVERAGE_LIMIT 100.0f

/* Lower triangle or all of block (i, j), which is symmetric in itself; coordinates divided by the unit. */
static FAST_CODE void place(const dpi_block_t *b, float scale, float per_row, int i, int j, gravity_equations_t m)
{
    const float second = scale * scale;
    const float rows[4][4] = {
        {b->one, scale * b->x, scale * b->y, scale * b->z},
        {scale * b->x, second * b->xx, second * b->xy, second * b->xz},
        {scale * b->y, second * b->xy, second * b->yy, second * b->yz},
        {scale * b->z, second * b->xz, second * b->yz, second * b->zz},
    };
    for (int k = 0; k < 4; k++) {
        for (int l = 0; l < 4; l++) {
            m[4 * i + k][4 * j + l] = per_row * rows[k][l];
        }
    }
}

static FAST_CODE void assemble(const dpi_sums_t *sums, gravity_equations_t m)
{
    const float scale = 1.0f / sums->unit, per_row = 1.0f / (float)sums->count;
    for (int i = 0; i < 3; i++) {
        place(&sums->diagonal[i], scale, per_row, i, i, m);
        for (int k = 0; k < 4; k++) {
            m[UNKNOWNS][4 * i + k] = per_row * (k == 0 ? sums->target[i][0] : scale * sums->target[i][k]);
        }
    }
    place(&sums->beside[0], scale, per_row, 1, 0, m);
    place(&sums->beside[1], scale, per_row, 2, 1, m);
    place(&sums->beside[2], scale, per_row, 2, 0, m);
}

/* The part of 1 that the solution explains: the mean of the fitted dot products. */
static FAST_CODE float explained_part(const dpi_sums_t *sums, const float x[UNKNOWNS])
{
    const float scale = 1.0f / sums->unit;
    float explained = 0.0f;
    for (int i = 0; i < 3; i++) {
        const float *const t = sums->target[i];
        explained += t[0] * x[4 * i] + scale * (t[1] * x[4 * i + 1] + t[2] * x[4 * i + 2] + t[3] * x[4 * i + 3]);
    }
    return explained / (float)sums->count;
}

/* Mean square of the corrected points' norms: the trace over gravity's components of the matrix, between the rows of K. */
static FAST_CODE float mean_square(const dpi_sums_t *sums, const float x[UNKNOWNS])
{
    const float scale = 1.0f / sums->unit, second = scale * scale;
    float weight = 0.0f, total = 0.0f;
    for (int i = 0; i < 3; i++) {
        const dpi_block_t *const b = &sums->diagonal[i];
        weight += b->one;
        for (int r = 0; r < 3; r++) {
            const float k = x[4 * r], kx = x[4 * r + 1], ky = x[4 * r + 2], kz = x[4 * r + 3];
            total += k * (k * b->one + 2.0f * scale * (kx * b->x + ky * b->y + kz * b->z)) +
                     second * (kx * (kx * b->xx + 2.0f * (ky * b->xy + kz * b->xz)) + ky * (ky * b->yy + 2.0f * kz * b->yz) +
                               kz * kz * b->zz);
        }
    }
    return total / weight;
}

static FAST_CODE fit_status_t check_sine(float sine, float wanted, float standard_error)
{
    const float least = SIGNIFICANCE * standard_error;
    if (!(__builtin_fabsf(sine) >= least) || !(__builtin_fabsf(wanted) >= least)) {
        return FIT_HORIZONTAL_FIELD;
    }
    return sine * wanted > 0.0f ? FIT_ELLIPSOID : FIT_MIRRORED;
}

static FAST_CODE void calibrate(const dpi_sums_t *sums, const float x[UNKNOWNS], const dpi_known_t *known,
                                dpi_fit_t *result)
{
    float adjugate[9];
    const float n = (float)sums->count;
    const float explained = explained_part(sums, x);
    const float determinant = gravity_adjugate(x, adjugate);
    const float square = mean_square(sums, x);
    if (!(explained > 0.0f) || !(square > 0.0f) || determinant == 0.0f) {
        fit_nothing(FIT_SINGULAR, &result->fit);
        return;
    }
    /* The rest to 1 is the mean square of the residuals, because they are orthogonal to the fit. */
    const float left = explained < 1.0f ? (1.0f - explained) * n / (n - (float)UNKNOWNS) : 0.0f;
    const float size = explained / __builtin_sqrtf(square);
    result->sine = determinant > 0.0f ? size : -size;
    result->standard_error = size * __builtin_sqrtf(left / explained);
    const float wanted = known->dip_is_given != 0u ? known->sine : result->sine;
    const fit_status_t status = check_sine(result->sine, wanted, result->standard_error);
    if (status == FIT_ELLIPSOID) {
        const gravity_solution_t solution = {
            .x = x, .adjugate = adjugate, .determinant = determinant, .anchor = sums->anchor, .unit = sums->unit};
        gravity_store(&solution, wanted / explained, &result->fit);
    } else {
        fit_nothing(status, &result->fit);
    }
}

static FAST_CODE void begin(uint16_t count, dpi_fit_t *result)
{
    fit_nothing(FIT_SINGULAR, &result->fit);
    result->fit.iterations = 0;
    result->fit.coverage = 0.0f;
    result->used = count;
    result->sine = 0.0f;
    result->standard_error = 0.0f;
}

static FAST_CODE void solve(const dpi_sums_t *sums, const dpi_known_t *known, dpi_fit_t *result)
{
    gravity_equations_t m;
    gravity_column_t column;
    float x[UNKNOWNS];
    if (!(sums->unit > 0.0f)) {
        return;
    }
    assemble(sums, m);
    for (int i = 0; i <= UNKNOWNS; i++) {
        column.border[i] = 0.0f;
    }
    column.share = 0.0f;
    result->fit.coverage = gravity_factor(m, &column);
    if (!(result->fit.coverage <= COVERAGE_LIMIT)) {
        return;
    }
    gravity_substitute(m, &column, x);
    calibrate(sums, x, known, result);
}

FAST_CODE void dpi_from_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, dpi_fit_t *result)
{
    dpi_sums_t sums;
    begin(pairs->count, result);
    if (pairs->count < DPI_PAIRS_MINIMUM) {
        result->fit.status = FIT_TOO_FEW_POINTS;
        return;
    }
    dpi_sum_pairs(pairs, known, &sums);
    solve(&sums, known, result);
}

static FAST_CODE uint16_t poses_of_enough_readings(const dpi_poses_t *poses)
{
    uint16_t count = 0;
    for (uint32_t index = 0; index < poses->count; index++) {
        if (poses->poses[index].readings >= DPI_POSE_READINGS) {
            count++;
        }
    }
    return count;
}

FAST_CODE void dpi_from_poses(const dpi_poses_t *poses, const dpi_known_t *known, dpi_fit_t *result)
{
    dpi_sums_t sums;
    begin(poses_of_enough_readings(poses), result);
    if (result->used < DPI_POSES_MINIMUM || result->used < poses->count) {
        result->fit.status = FIT_TOO_FEW_POINTS;
        return;
    }
    dpi_sum_poses(poses, known, &sums);
    solve(&sums, known, result);
}
