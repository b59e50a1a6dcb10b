/**
 * @file pose_buffer.h
 * @brief The still poses that accelerometer and magnetometer are calibrated from, in the order they came.
 */
#ifndef HILTEST_POSE_BUFFER_H
#define HILTEST_POSE_BUFFER_H

#include <stdbool.h>

#include "calibration/still_pose.h"

#define POSES_MAXIMUM 128u

void poses_clear(void);

uint8_t poses_count(void);

/** Store a pose. False when the buffer is full. */
bool poses_store(const still_pose_t *pose);

/** The stored poses, poses_count() of them. */
const still_pose_t *poses_stored(void);

#endif
