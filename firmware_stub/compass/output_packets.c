/** @file output_packets.c @brief The same as packets of NXP's Sensor Fusion Toolbox, release 7: what needs no gyroscope. */
#include <math.h>
#include <string.h>

#include "boards/time_base.h"
#include "boards/uart.h"
#include "compass.h"
#include "protocol/stuffing.h"

/* The last bytes of type 1: accelerometer and magnetometer (2) in north, east, down (0); K64F (5) with the MULTI-B shield (0). */
#define ALGORITHM_AND_BOARD 0x0502
#define HALF_A_DEGREE 0.008726646260f /* [rad] */
#define VARIABLES 4u /* of type 6: dip, hard iron and the two of soft iron; others would show a buffer of another shape */

static uint8_t wire[3u * 2u * 38u], packets, variable; /* room for three packets with every byte escaped */
static uint32_t wire_length;

/** Add a packet: type, number, a time or none, and 16-bit numbers, all little-endian as this core. */
static void add(uint8_t type, const uint32_t *time_us, const float values[], uint32_t count)
{
    uint8_t body[40] = {type, packets++};
    uint32_t length = 2;
    if (time_us != NULL) {
        memcpy(&body[length], time_us, sizeof *time_us);
        length += sizeof *time_us;
    }
    for (uint32_t i = 0; i < count; i++, length += 2u) {
        const int16_t bounded = (int16_t)fminf(fmaxf(values[i], -32768.0f), 32767.0f);
        memcpy(&body[length], &bounded, sizeof bounded);
    }
    wire_length += stuff(body, length, &wire[wire_length]);
}

static float dip_deg(const compass_state_t *state)
{
    const float *const g = state->gravity, *const b = state->field;
    const float lengths = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) * (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]);
    return 0.5f / HALF_A_DEGREE * asinf(fminf(fmaxf((g[0] * b[0] + g[1] * b[1] + g[2] * b[2]) / sqrtf(lengths), -1.0f), 1.0f));
}

static void add_main(const compass_state_t *state)
{
    const float *const g = state->gravity, *const b = state->field, q = 30000.0f, field = 10.0f * UT_PER_COUNT;
    const float ch = cosf(HALF_A_DEGREE * state->heading_deg), sh = sinf(HALF_A_DEGREE * state->heading_deg);
    const float cp = cosf(HALF_A_DEGREE * state->pitch_deg), sp = sinf(HALF_A_DEGREE * state->pitch_deg);
    const float cr = cosf(HALF_A_DEGREE * state->roll_deg), sr = sinf(HALF_A_DEGREE * state->roll_deg);
    const float values[] = {
        8192.0f * g[0], 8192.0f * g[1], 8192.0f * g[2], field * b[0], field * b[1], field * b[2], 0.0f, 0.0f, 0.0f,
        q * (ch * cp * cr + sh * sp * sr), q * (ch * cp * sr - sh * sp * cr), q * (ch * sp * cr + sh * cp * sr),
        q * (sh * cp * cr - ch * sp * sr), ALGORITHM_AND_BOARD,
    };
    add(1, &state->time_us, values, sizeof values / sizeof values[0]);
}

/** Points, error and strength, and three numbers of the calibration in turn. */
static void add_calibration(const compass_state_t *state, const background_t *background)
{
    const iron_t *const iron = &background->iron;
    const float *const h = iron->hard_iron, *const w = iron->soft_iron, ut = 10.0f * UT_PER_COUNT;
    const float shown[VARIABLES][3] = {{0.0f, 0.0f, 10.0f * dip_deg(state)}, {ut * h[0], ut * h[1], ut * h[2]},
                                       {1000.0f * w[0], 1000.0f * w[4], 1000.0f * w[8]},
                                       {1000.0f * w[1], 1000.0f * w[2], 1000.0f * w[5]}};
    const float *const n = shown[variable], points = (float)background->count;
    const float values[] = {points, 100.0f * iron->error_percent, ut * iron->strength, variable, n[0], n[1], n[2]};
    add(6, NULL, values, sizeof values / sizeof values[0]);
    variable = (uint8_t)((variable + 1u) % VARIABLES);
}

void output_state(const compass_state_t *state, const background_t *background)
{
    (void)uart_wait_until_sent(WAIT_FOREVER); /* the UART reads the packets where they are */
    wire_length = 0;
    if (state->has_heading) {
        add_main(state);
        add(4, &state->time_us, (const float[]){10.0f * state->roll_deg, 10.0f * state->pitch_deg, 10.0f * state->heading_deg}, 3);
    }
    add_calibration(state, background);
    uart_send(wire, wire_length);
}

void output_answer(const char *text)
{
    (void)text;
}

void output_error(const char *what)
{
    (void)what; /* there is no packet for it: silence */
}
