/**
 * @file fusion.h
 * @brief Kalman filter for attitude: the gyroscope predicts, accelerometer and magnetometer correct.
 *
 * The filter of Mucciaccia's thesis, sections 2.4 and 3.4: equations (28), (33) and (34) on a quaternion (11), measured as one
 * (H = I) by TRIAD. With what the thesis leaves open chosen as docs/fusion.md says, its 4x4 covariances need not be formed. Write
 * L for the products of north, east and down with the attitude, as columns: they are the directions in which a unit
 * quaternion can change. Then, Q being equal about all axes,
 *
 *     P = L diag(tilt, tilt, heading) L' / 4      and      F L = L of the predicted attitude,
 *
 * so a prediction adds a number to the variances, a measurement has the gain p / (p + r) on each axis, and this is the matrix
 * filter, not a simplification of it. src/hiltest/orientation/fusion.py has the matrices; tests compare the two.
 */
#ifndef HILTEST_FUSION_H
#define HILTEST_FUSION_H

/** What became of a step; all but OK leave the state as it was. */
typedef enum {
    FUSION_OK = 0,
    FUSION_NO_ATTITUDE, /**< gravity or field has no norm within 1e-6 to 1e6, or they are parallel */
    FUSION_ACCELERATED, /**< the norm of gravity is not 1 g within the gate */
    FUSION_BAD_STEP,    /**< rate or time not finite, time negative, or more than half a turn in one step */
} fusion_status_t;

/** How far the sensors are trusted; the variances are above 0. */
typedef struct {
    float rate_variance;    /**< what a second of the rate's white noise adds to each rotation's variance [rad^2/s] */
    float tilt_variance;    /**< of a measured attitude about north and about east [rad^2] */
    float heading_variance; /**< of a measured attitude about down [rad^2] */
    float gate_g;           /**< gravity is used when its norm is 1 g within this */
} fusion_noise_t;

/** The state. */
typedef struct {
    float attitude[4];      /**< unit quaternion x, y, z, w; takes body components to north, east, down */
    float tilt_variance;    /**< of the attitude about north, and about east [rad^2] */
    float heading_variance; /**< of the attitude about down [rad^2] */
} fusion_t;

/**
 * Form the attitude that gravity and field show: down along gravity, north where the field is (TRIAD).
 *
 * @param gravity_g body frame (x forward, y right, z down), positive down: level is (0, 0, +1) [g]
 * @param field corrected magnetic field in the body frame, any scale
 * @param gate_g gravity must be 1 g within this
 * @param[out] attitude unit quaternion, of either sign; stored only with FUSION_OK
 */
fusion_status_t fusion_triad(const float gravity_g[3], const float field[3], float gate_g, float attitude[4]);

/** Begin with a unit quaternion that is as good as a measured one. */
void fusion_start(fusion_t *state, const fusion_noise_t *noise, const float attitude[4]);

/**
 * Turn the attitude by a rate, equation (28): `q = q F`, `P = F P F' + Q`.
 *
 * @param rate_rad_s about the body's axes, bias removed; counts as constant over the step [rad/s]
 * @param dt_s length of the step [s]
 */
fusion_status_t fusion_predict(fusion_t *state, const fusion_noise_t *noise, const float rate_rad_s[3], float dt_s);

/** Correct the attitude by that of gravity and field, equations (33) and (34). Parameters as in fusion_triad(). */
fusion_status_t fusion_update(fusion_t *state, const fusion_noise_t *noise, const float gravity_g[3], const float field[3]);

/** Steps that do nothing: what calling one costs is measured with them. */
fusion_status_t empty_fusion_predict(fusion_t *state, const fusion_noise_t *noise, const float rate_rad_s[3], float dt_s);
fusion_status_t empty_fusion_update(fusion_t *state, const fusion_noise_t *noise, const float gravity_g[3],
                                    const float field[3]);

#endif
