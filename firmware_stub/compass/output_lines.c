/** @file output_lines.c @brief The output of the compass, as lines. */
#include <math.h>
#include <string.h>

#include "boards/time_base.h"
#include "boards/uart.h"
#include "compass.h"

static char line[200]; /* the longest has some 170 */
static uint32_t length;

static void put(const char *text)
{
    if (length == 0u) {
        (void)uart_wait_until_sent(WAIT_FOREVER); /* the UART reads the line where it is */
    }
    for (; *text != '\0' && length < sizeof line; text++) {
        line[length++] = *text;
    }
}

/** Write a number of up to 4 decimals: printf() would bring a heap, and double arithmetic. NaN becomes 999999999. */
static void put_number(const char *name, float value, uint32_t decimals)
{
    static const float scales[] = {1.0f, 10.0f, 100.0f, 1000.0f, 10000.0f};
    const float magnitude = fabsf(value) * scales[decimals] + 0.5f;
    uint32_t left = magnitude < 1.0e9f ? (uint32_t)magnitude : 999999999u;
    char text[16] = ""; /* from its end */
    uint32_t at = sizeof text - 1u;
    put(name);
    put(value < 0.0f && left > 0u ? "-" : "");
    for (uint32_t written = 0; written <= decimals || left > 0u; written++) {
        if (written == decimals && decimals > 0u) {
            text[--at] = '.';
        }
        text[--at] = (char)('0' + left % 10u);
        left /= 10u;
    }
    put(&text[at]);
}

static void put_vector(const char *name, const float vector[3], float unit, uint32_t decimals)
{
    for (uint32_t axis = 0; axis < 3u; axis++) {
        put_number(axis == 0u ? name : ",", vector[axis] * unit, decimals);
    }
}

static void send(void)
{
    put("\r\n");
    uart_send((const uint8_t *)line, length);
    length = 0;
}

void output_state(const compass_state_t *state, const background_t *background)
{
    static iron_t told;
    const iron_t *const iron = &background->iron;
    if (iron->strength > 0.0f && memcmp(&told, iron, sizeof told) != 0) {
        put_number("CALIBRATED points=", (float)background->count, 0);
        put_vector(" hard=", iron->hard_iron, UT_PER_COUNT, 2);
        put_vector(" soft=", &iron->soft_iron[0], 1.0f, 4);
        put_vector(",", &iron->soft_iron[3], 1.0f, 4);
        put_vector(",", &iron->soft_iron[6], 1.0f, 4);
        put_number(" field=", iron->strength * UT_PER_COUNT, 2);
        put_number(" error=", iron->error_percent, 2);
        send();
        told = *iron;
    }
    put(iron->strength > 0.0f ? "CAL=1" : "CAL=0");
    if (state->has_heading) {
        put_number(" HDG=", state->heading_deg, 2);
        put_number(" PIT=", state->pitch_deg, 2);
        put_number(" ROL=", state->roll_deg, 2);
    }
    put_vector(" RAW=", state->raw, UT_PER_COUNT, 2);
    put_vector(" MAG=", state->field, UT_PER_COUNT, 2);
    put_vector(" ACC=", state->gravity, 1.0f, 4);
    if (state->has_rate) {
        put_vector(" GYR=", state->rate_dps, 1.0f, 2);
    }
    send();
}

void output_answer(const char *text)
{
    put(text);
    send();
}

void output_error(const char *what)
{
    put("ERROR ");
    put(what);
    send();
}
