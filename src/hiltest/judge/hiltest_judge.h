/** @file hiltest_judge.h
 *  @brief Functions that `hiltest judge` judges. Write the one that you have; a file needs no other one.
 *
 *  Axes: x forward, y right, z down, right-handed. Field in uT, acceleration in g (1 g along the axis that points down
 *  if the body is at rest), rate of rotation in rad/s.
 */
#ifndef HILTEST_JUDGE_H
#define HILTEST_JUDGE_H

#ifdef __cplusplus
extern "C" {
#endif

/** Calibrate a magnetometer from samples taken in all attitudes.
 *
 *  @param samples n readings [uT]
 *  @param n number of samples, 12 to 1 000
 *  @param hard_iron offset [uT]
 *  @param soft_iron matrix that is applied after the offset is subtracted: soft_iron (sample - hard_iron) is along the
 *                   field. Its scale is free.
 *  @return 0, or any other number if the calibration must not be used
 */
int calibrate(const float samples[][3], int n, float hard_iron[3], float soft_iron[3][3]);

/** The same with the acceleration that was measured with each sample [g]. */
int calibrate_pairs(
    const float samples[][3], const float accelerations[][3], int n, float hard_iron[3], float soft_iron[3][3]);

/** Start a filter anew.
 *
 *  @param rate_hz rate of the updates [Hz]
 */
void filter_init(float rate_hz);

/** Follow one reading of all sensors. Variables are kept between calls.
 *
 *  @param gyroscope rate of rotation without its bias [rad/s]
 *  @param acceleration gravity and minus the acceleration [g]: level and at rest it is (0, 0, 1)
 *  @param field calibrated magnetic field [uT]
 *  @param dt time since the last reading [s]
 */
void filter_update(const float gyroscope[3], const float acceleration[3], const float field[3], float dt);

/** Copy the attitude: the quaternion x, y, z, w that turns vectors of the body into north, east, down. */
void filter_quaternion(float quaternion[4]);

/** The heading, for filters without filter_quaternion: of the x axis, clockwise from magnetic north.
 *
 *  @return angle [deg]
 */
float filter_heading(void);

#ifdef __cplusplus
}
#endif
#endif
