/** @file compass.h @brief Declarations that main.c, background.c and output_*.c share; the sensors are in sensors.h. x is forward, y right, z down. */
#ifndef COMPASS_H
#define COMPASS_H

#include <stdbool.h>
#include <stdint.h>

#define UT_PER_COUNT 0.1f
#define POINTS_KEPT 256u /* more than lie apart in the strongest field, 67 uT */

/** The calibration for the iron nearby: `field = soft_iron * (counts - hard_iron)`, in counts too. */
typedef struct {
    float hard_iron[3];  /**< [counts] */
    float soft_iron[9];  /**< row-major 3x3, its diagonal 1 in the mean */
    float strength;      /**< of the earth's field [counts]; 0 before the first calibration */
    float error_percent; /**< rms of what is left, of the strength; 100 before the first calibration */
} iron_t;

/** The calibration and the points that it is made from. */
typedef struct {
    int16_t points[POINTS_KEPT][3];   /**< [counts] */
    uint32_t taken_at[POINTS_KEPT];   /**< number of the sample that each is */
    uint32_t count, changes, samples; /**< points; how many came or were renewed since the last fit; all samples */
    iron_t iron;
} background_t;

/** The state of the compass at a moment. */
typedef struct {
    uint32_t time_us;
    float gravity[3]; /**< [g]; level is 0, 0, 1 */
    float raw[3];     /**< magnetometer [counts] */
    float field[3];   /**< the same without the iron [counts] */
    float heading_deg, pitch_deg, roll_deg;
    bool has_heading; /**< else the three angles mean nothing */
    float rate_dps[3];
    bool has_rate; /**< else there is no gyroscope, or it is silent */
} compass_state_t;

/** No points, and no iron: what a background_t begins with. */
#define BACKGROUND_START {.iron = {.soft_iron = {[0] = 1.0f, [4] = 1.0f, [8] = 1.0f}, .error_percent = 100.0f}}

/** Look at a sample [counts], and calibrate when it makes that worth while; take the iron off a field. */
void background_take(background_t *background, const int16_t sample[3]);
void iron_remove(const iron_t *iron, const float raw[3], float field[3]);

/** Say what is known, or what is wrong; waits while the UART still has the words of before. */
void output_state(const compass_state_t *state, const background_t *background);
void output_error(const char *what);

/** Answer a typed line. */
void output_answer(const char *text);

#endif
