/* The normal equations of norm and dot product together, and the step that they give. */
#include "joint.h"

#include "fast_code.h"
#include "fit_result.h"
#include "gravity_equations.h"
#include "joint_sums.h"

#define UNKNOWNS GRAVITY_UNKNOWNS
#define ALL_UNKNOWNS 13 /* with the sine of the dip */

/* A rotation by this, squared, leaves 0.02 degrees to the next step, a tenth of what noise makes. */
#define LARGEST_TURN 0.035f /* 2 degrees */

/* 60 degrees take 3. */
#define STEPS 4

/* Times the pivot that attitudes all round would have. */
#define COVERAGE_LIMIT 100.0f

/* A field within 3 degrees of the vertical has a horizontal part of 5 %: no heading. */
#define SMALLEST_COSINE 0.05f

/* Standard error of a dot product relative to the cosine of the dip, which is the noise relative to the field: of axes that no rotation
 * brings together it is 0.3 or more, of noise of a tenth of the field 0.1. */
#define LARGEST_ERROR 0.2f

/* The inputs of a step besides the sums. */
typedef struct {
    union { /* the equations are assembled when all rows are added */
        gravity_equations_t m;
        joint_row_t rows[JOINT_ROWS];
    };
    gravity_column_t column;
    float weight;        /* sum of |p|^2 */
    float standard_error;
    float sine;
    float turn_squared;
} joint_step_t;

typedef float (*block_t)[UNKNOWNS];

/* Block of component i and the next, in the lower triangle. */
static inline block_t beside_block(gravity_equations_t m, int i)
{
    return (block_t)&m[i == 2 ? 8 : 4 * i + 4][i == 2 ? 0 : 4 * i];
}

static FAST_CODE void place_beside(const joint_component_t *c, float scale, block_t b)
{
    const float one = scale * c->b_one;
    b[0][0] = one;
    b[0][1] = b[1][0] = scale * c->x;
    b[0][2] = b[2][0] = scale * c->y;
    b[0][3] = b[3][0] = scale * c->z;
    b[1][2] = b[2][1] = scale * c->xy;
    b[1][3] = b[3][1] = scale * c->xz;
    b[2][3] = b[3][2] = scale * c->yz;
    const float xx = scale * c->xx, yy = scale * c->yy;
    b[1][1] = xx;
    b[2][2] = yy;
    b[3][3] = one - xx - yy; /* |u| = 1 */
}

/* Block (i, i), of which t . u = 0 gives the row and the column of u_i: t_i u_i = -(t_n u_n + t_o u_o). */
static FAST_CODE void place_own(const joint_component_t *c, float scale, int i, gravity_equations_t m)
{
    const int next = i == 2 ? 0 : i + 1, third = i == 0 ? 2 : i - 1, at = 1 + i, n = 1 + next, o = 1 + third;
    const block_t b = (block_t)&m[4 * i][4 * i], with_next = beside_block(m, i), with_third = beside_block(m, third);
    b[0][0] = scale * c->one;
    b[0][n] = b[n][0] = scale * c->n;
    b[0][o] = b[o][0] = scale * c->o;
    b[n][n] = scale * c->nn;
    b[n][o] = b[o][n] = scale * c->no;
    for (int k = 0; k < 4; k++) {
        b[at][k] = b[k][at] = -with_next[n][k] - with_third[o][k];
    }
    b[o][o] = b[0][0] - b[n][n] - b[at][at];
}

/* All of the lower triangle, divided by the weight, and the target. */
static FAST_CODE void assemble(const joint_sums_t *sums, float count, joint_step_t *step)
{
    const float weight = sums->components[0].one + sums->components[1].one + sums->components[2].one;
    const float per_weight = 1.0f / weight, mean = sums->dots / count;
    float(*const m)[UNKNOWNS] = step->m;
    step->weight = weight;
    for (int i = 0; i < 3; i++) {
        const joint_component_t *const c = &sums->components[i];
        place_beside(c, -per_weight, beside_block(m, i));
        for (int k = 0; k < 4; k++) {
            step->column.border[4 * i + k] = c->border[k];
            m[UNKNOWNS][4 * i + k] = per_weight * (mean * c->border[k] - c->target[k]);
        }
    }
    for (int i = 0; i < 3; i++) {
        place_own(&sums->components[i], -per_weight, i, m);
    }
    for (int k = 0; k < 4; k++) {
        for (int l = 0; l <= k; l++) {
            const float all = m[k][l] + m[4 + k][4 + l] + m[8 + k][8 + l];
            m[k][l] -= all;
            m[4 + k][4 + l] -= all;
            m[8 + k][8 + l] -= all;
        }
    }
    step->column.border[UNKNOWNS] = 0.0f;
    step->column.share = per_weight / count;
}

/* The sum of squares that the solution leaves, and the sine that it moves. */
static FAST_CODE void judge(const joint_sums_t *sums, float count, const float change[UNKNOWNS], joint_step_t *step)
{
    float explained = 0.0f, moved = sums->dots;
    for (int j = 0; j < UNKNOWNS; j++) {
        const float reduced = step->m[UNKNOWNS][j];
        explained += reduced * reduced * step->column.reciprocals[j];
        moved += step->column.border[j] * change[j];
    }
    const float left = sums->squares - sums->dots * sums->dots / count - step->weight * explained;
    step->standard_error = left > 0.0f ? __builtin_sqrtf(left / (2.0f * count - (float)ALL_UNKNOWNS)) : 0.0f;
    step->sine = moved / count;
}

/* Stretch by the symmetric part of the change, after the rotation whose vector its other part is: Cayley's, which needs no sine. */
static FAST_CODE void apply(const float change[UNKNOWNS], joint_step_t *step, float x[UNKNOWNS])
{
    const float half[3] = {0.25f * (change[10] - change[7]), 0.25f * (change[3] - change[9]), 0.25f * (change[5] - change[2])};
    const float square = half[0] * half[0] + half[1] * half[1] + half[2] * half[2], scale = 2.0f / (1.0f + square);
    float turned[UNKNOWNS];
    step->turn_squared = 4.0f * square;
    for (int column = 0; column < 4; column++) {
        const float v[3] = {x[column], x[4 + column], x[8 + column]};
        const float along = half[0] * v[0] + half[1] * v[1] + half[2] * v[2];
        const float cross[3] = {half[1] * v[2] - half[2] * v[1], half[2] * v[0] - half[0] * v[2], half[0] * v[1] - half[1] * v[0]};
        for (int r = 0; r < 3; r++) {
            turned[4 * r + column] = v[r] + scale * (cross[r] + half[r] * along - square * v[r]);
        }
    }
    for (int r = 0; r < 3; r++) {
        for (int column = 0; column < 4; column++) {
            float value = turned[4 * r + column];
            for (int k = 0; k < 3; k++) {
                value += 0.5f * (change[4 * r + 1 + k] + change[4 * k + 1 + r]) * turned[4 * k + column];
            }
            x[4 * r + column] = value;
        }
        x[4 * r] += change[4 * r];
    }
}

static FAST_CODE fit_status_t status_of(const joint_step_t *step, const dpi_known_t *known, float count)
{
    const float error = step->standard_error;
    if (!(step->weight >= SMALLEST_COSINE * SMALLEST_COSINE * count)) {
        return FIT_POOR_COVERAGE;
    }
    if (!(error * error * count <= LARGEST_ERROR * LARGEST_ERROR * step->weight) ||
        (known->dip_is_given != 0u && step->sine * known->sine < 0.0f)) {
        return FIT_MIRRORED;
    }
    return step->turn_squared < LARGEST_TURN * LARGEST_TURN ? FIT_ELLIPSOID : FIT_NOT_CONVERGED;
}

/* One step; false when the attitudes do not determine it. */
static FAST_CODE bool take_step(const dpi_pairs_t *pairs, const dpi_known_t *known, float x[UNKNOWNS], joint_step_t *step,
                                float *coverage)
{
    joint_sums_t sums;
    float change[UNKNOWNS];
    const float count = (float)pairs->count;
    joint_sum_pairs(pairs, known, x, step->rows, &sums);
    assemble(&sums, count, step);
    *coverage = gravity_factor(step->m, &step->column);
    if (!(*coverage <= COVERAGE_LIMIT)) {
        return false;
    }
    gravity_substitute(step->m, &step->column, change);
    judge(&sums, count, change, step);
    apply(change, step, x);
    return true;
}

static FAST_CODE void finish(const dpi_known_t *known, const joint_step_t *step, const float x[UNKNOWNS], dpi_fit_t *result)
{
    float adjugate[9];
    const float origin[3] = {0.0f, 0.0f, 0.0f};
    const float determinant = gravity_adjugate(x, adjugate);
    const gravity_solution_t solution = {.x = x, .adjugate = adjugate, .determinant = determinant, .anchor = origin, .unit = 1.0f};
    const fit_status_t status = status_of(step, known, (float)result->used);
    result->sine = step->sine;
    result->standard_error = step->standard_error;
    if ((status == FIT_ELLIPSOID || status == FIT_NOT_CONVERGED) && determinant > 0.0f) {
        gravity_store(&solution, 1.0f, &result->fit);
        result->fit.status = status;
    } else {
        fit_nothing(status == FIT_ELLIPSOID ? FIT_SINGULAR : status, &result->fit);
    }
}

/* Take steps from a calibration. Its room, of which rows of pairs are most, is not on the stack while `direct-fast` has its own. */
static FAST_CODE __attribute__((noinline)) void refine(const dpi_pairs_t *pairs, const dpi_known_t *known, float x[UNKNOWNS],
                                                       dpi_fit_t *result)
{
    joint_step_t step;
    uint16_t steps = 0;
    do {
        if (!take_step(pairs, known, x, &step, &result->fit.coverage)) {
            fit_nothing(steps == 0u ? FIT_SINGULAR : FIT_MIRRORED, &result->fit); /* what was determined went astray */
            return;
        }
        steps++;
    } while (steps < STEPS && !(step.turn_squared < LARGEST_TURN * LARGEST_TURN));
    result->fit.iterations = steps;
    finish(known, &step, x, result);
}

FAST_CODE void joint_from_pairs(const dpi_pairs_t *pairs, const dpi_known_t *known, dpi_fit_t *result)
{
    magnetometer_points_t points = {.points = pairs->magnetometer, .count = pairs->count, .iterations = 0};
    magnetometer_fit_t *const fit = &result->fit;
    float x[UNKNOWNS];
    result->used = pairs->count;
    result->sine = 0.0f;
    result->standard_error = 0.0f;
    fit->iterations = 0;
    fit->coverage = 0.0f;
    if (pairs->count < JOINT_PAIRS_MINIMUM) {
        fit_nothing(FIT_TOO_FEW_POINTS, fit);
        return;
    }
    for (int axis = 0; axis < 3; axis++) {
        points.minimum[axis] = pairs->minimum[axis];
        points.maximum[axis] = pairs->maximum[axis];
    }
    magnetometer_direct_fast(&points, fit);
    if (fit->status != FIT_ELLIPSOID) {
        return;
    }
    for (int r = 0; r < 3; r++) {
        x[4 * r] = 0.0f;
        for (int c = 0; c < 3; c++) {
            x[4 * r + 1 + c] = fit->soft_iron[3 * r + c];
            x[4 * r] -= fit->soft_iron[3 * r + c] * fit->hard_iron[c];
        }
    }
    refine(pairs, known, x, result);
}
