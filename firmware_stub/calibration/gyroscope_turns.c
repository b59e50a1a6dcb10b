#include "gyroscope_turns.h"

#include <math.h>
#include <stdbool.h>

#include "fast_code.h"

/** Less than a quarter turn weighs the table's own error four times as much as a whole one. */
#define SMALLEST_TURN_DEG 90.0f
/**
 * Least determinant of a matrix beside the cube of its longest row. Of the turns' second moments it is 1 for three at right angles
 * and 0.001 when the third is 5 degrees out of the plane of the others; a gyroscope's response is held to the same.
 */
#define LEAST_DETERMINANT 1e-3f

FAST_CODE void gyroscope_turn_integral(const gyroscope_turn_t *turn, float integral[3])
{
    const float count = (float)turn->count;
    const float period_s = turn->count < 2u ? 0.0f : 1e-6f * (float)turn->duration_us / (count - 1.0f);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float bias = turn->bias_before[axis] + turn->share * (turn->bias_after[axis] - turn->bias_before[axis]);
        integral[axis] = period_s * ((float)turn->sum[axis] - count * bias);
    }
}

/** Written out: of a loop, or an initialiser, the compiler may make a call to memset, which is in flash. */
FAST_CODE static void clear(float matrix[9])
{
    matrix[0] = matrix[1] = matrix[2] = 0.0f;
    matrix[3] = matrix[4] = matrix[5] = 0.0f;
    matrix[6] = matrix[7] = matrix[8] = 0.0f;
}

FAST_CODE static float dot(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

FAST_CODE static void cross(const float a[3], const float b[3], float product[3])
{
    product[0] = a[1] * b[2] - a[2] * b[1];
    product[1] = a[2] * b[0] - a[0] * b[2];
    product[2] = a[0] * b[1] - a[1] * b[0];
}

/**
 * Invert a 3x3 matrix of rows a, b, c: the columns of the inverse are b x c, c x a and a x b over the determinant. False when its
 * determinant is small: see LEAST_DETERMINANT.
 */
FAST_CODE static bool invert(const float rows[9], float inverse[9])
{
    const float *a = &rows[0];
    const float *b = &rows[3];
    const float *c = &rows[6];
    float longest = dot(a, a);
    longest = dot(b, b) > longest ? dot(b, b) : longest;
    longest = dot(c, c) > longest ? dot(c, c) : longest;
    float columns[3][3];
    cross(b, c, columns[0]);
    cross(c, a, columns[1]);
    cross(a, b, columns[2]);
    const float determinant = dot(a, columns[0]);
    if (!(fabsf(determinant) > LEAST_DETERMINANT * longest * sqrtf(longest))) {
        return false;
    }
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            inverse[3u * row + column] = columns[column][row] / determinant;
        }
    }
    return true;
}

FAST_CODE static void multiply(const float left[9], const float right[9], float product[9])
{
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            const float *cells = &left[3u * row];
            product[3u * row + column] =
                cells[0] * right[column] + cells[1] * right[3u + column] + cells[2] * right[6u + column];
        }
    }
}

/** Add `left right'` to a matrix. */
FAST_CODE static void add_product(float sum[9], const float left[3], const float right[3])
{
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            sum[3u * row + column] += left[row] * right[column];
        }
    }
}

FAST_CODE static float residual_deg(const gyroscope_turns_t *turns, const float matrix[9])
{
    float squares = 0.0f;
    for (uint32_t i = 0; i < turns->count; i++) {
        float integral[3];
        gyroscope_turn_integral(&turns->turns[i], integral);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            const float left = dot(&matrix[3u * axis], integral) - turns->turns[i].turned_deg[axis];
            squares += left * left;
        }
    }
    return sqrtf(squares / (float)turns->count);
}

FAST_CODE void gyroscope_turns_fit(const gyroscope_turns_t *turns, gyroscope_turns_fit_t *fit)
{
    fit->status = GYROSCOPE_TURNS_TOO_FEW;
    fit->at_fault = GYROSCOPE_TURNS_MAXIMUM;
    fit->residual_deg = 0.0f;
    clear(fit->matrix);
    if (turns->count < 3u || turns->count > GYROSCOPE_TURNS_MAXIMUM) {
        return;
    }
    float turned_turned[9]; /* sum t t' */
    float seen_turned[9];   /* sum s t' */
    clear(turned_turned);
    clear(seen_turned);
    for (uint8_t i = 0; i < turns->count; i++) {
        const gyroscope_turn_t *turn = &turns->turns[i];
        if (!(dot(turn->turned_deg, turn->turned_deg) >= SMALLEST_TURN_DEG * SMALLEST_TURN_DEG) || turn->count < 2u) {
            fit->status = GYROSCOPE_TURNS_TOO_SMALL;
            fit->at_fault = i;
            return;
        }
        float integral[3];
        gyroscope_turn_integral(turn, integral);
        add_product(turned_turned, turn->turned_deg, turn->turned_deg);
        add_product(seen_turned, integral, turn->turned_deg);
    }
    float inverse[9];
    if (!invert(turned_turned, inverse)) {
        fit->status = GYROSCOPE_TURNS_NOT_SPANNING;
        return;
    }
    float response[9];
    multiply(seen_turned, inverse, response);
    if (!invert(response, fit->matrix)) {
        fit->status = GYROSCOPE_TURNS_SINGULAR;
        return;
    }
    fit->status = GYROSCOPE_TURNS_OK;
    fit->residual_deg = residual_deg(turns, fit->matrix);
}
