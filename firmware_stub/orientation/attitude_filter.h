/**
 * @file attitude_filter.h
 * @brief Attitude from gyroscope, slow corrections of the tilt, and slower ones of the heading.
 *
 * The acceleration passes a second-order low-pass in the frame that the gyroscope integrates (Laidig and Seel, VQF,
 * Information Fusion 91, 2023, section 3), and that frame is corrected until the filtered acceleration is vertical. So of the
 * low-pass only the rate of its horizontal part remains. With the horizontal acceleration a in g and w = sqrt(2) / tilt time,
 *
 *     rate' = w^2 a - sqrt(2) w rate,
 *
 * and the tilt turns at that rate. The heading follows the field with a gain of dt / heading time. Before twice these times have
 * passed, tilt and heading follow means of all measurements, which weigh each one by its time since the start.
 *
 * src/hiltest/orientation/attitude_filter.py is the same in float64; docs/fusion.md derives the numbers below and has the
 * errors on recorded motion.
 */
#ifndef HILTEST_ATTITUDE_FILTER_H
#define HILTEST_ATTITUDE_FILTER_H

#include <stdbool.h>

/** Time constant of the tilt [s]. */
#define ATTITUDE_FILTER_TILT_TIME_S 3.0f

/** Time constant of the heading [s]. */
#define ATTITUDE_FILTER_HEADING_TIME_S 20.0f

/** Largest distance of the field from the expected one that corrects the heading, in parts of the expected one. */
#define ATTITUDE_FILTER_FIELD_GATE 0.1f

/** Time constant of the expected field [s], once the heading has its own. */
#define ATTITUDE_FILTER_FIELD_TIME_S 100.0f

/** Result of a step. */
typedef enum {
    ATTITUDE_FILTER_OK = 0,
    ATTITUDE_FILTER_NO_ATTITUDE,    /**< gravity, or before the first attitude the field, cannot be used; not corrected */
    ATTITUDE_FILTER_FIELD_LEFT_OUT, /**< the tilt is corrected, the heading is not: no field, a vertical or a disturbed one */
    ATTITUDE_FILTER_BAD_STEP,       /**< rate or time not finite, time negative, or more than half a turn; nothing changed */
} attitude_filter_status_t;

/** The state: 14 words. */
typedef struct {
    float attitude[4];   /**< unit quaternion x, y, z, w; takes body components to north, east, down */
    float bias_rad_s[3]; /**< rate at rest, which is subtracted */
    float tilt_rate[2];  /**< low-pass's, about north and about east [rad/s] */
    float field[2];      /**< expected, horizontal and down, in the unit of the field */
    float age_s;         /**< since the first attitude */
    float uncorrected_s; /**< since the last correction */
    bool started;        /**< there is an attitude */
} attitude_filter_t;

/**
 * Forget everything: the attitude is no rotation until the first correction.
 *
 * @param bias_rad_s mean rate of the resting body
 */
void attitude_filter_init(attitude_filter_t *state, const float bias_rad_s[3]);

/**
 * Turn the attitude, then correct it.
 *
 * @param rate_rad_s mean about the body's axes over the step, with its bias [rad/s]
 * @param gravity_g body frame, positive down: level is (0, 0, +1) if z points down [g]
 * @param field calibrated magnetic field in the body frame, in any unit
 * @param dt_s length of the step [s]
 */
attitude_filter_status_t attitude_filter_update(attitude_filter_t *state, const float rate_rad_s[3],
                                                const float gravity_g[3], const float field[3], float dt_s);

/** Do nothing: the cost of calling an update is measured with it. */
attitude_filter_status_t empty_attitude_filter_update(attitude_filter_t *state, const float rate_rad_s[3],
                                                      const float gravity_g[3], const float field[3], float dt_s);

/** Only turn the attitude, if the gyroscope is faster than the others. Parameters as in attitude_filter_update(). */
attitude_filter_status_t attitude_filter_turn(attitude_filter_t *state, const float rate_rad_s[3], float dt_s);

/** Only correct it, for the time turned since the last correction. Parameters as in attitude_filter_update(). */
attitude_filter_status_t attitude_filter_correct(attitude_filter_t *state, const float gravity_g[3], const float field[3]);

/** Copy the attitude: x, y, z, w. */
void attitude_filter_attitude(const attitude_filter_t *state, float attitude[4]);

#endif
