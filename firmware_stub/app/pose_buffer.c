#include "pose_buffer.h"

static struct {
    still_pose_t poses[POSES_MAXIMUM];
    uint8_t count;
} buffer;

void poses_clear(void)
{
    buffer.count = 0;
}

uint8_t poses_count(void)
{
    return buffer.count;
}

bool poses_store(const still_pose_t *pose)
{
    if (buffer.count >= POSES_MAXIMUM) {
        return false;
    }
    buffer.poses[buffer.count++] = *pose;
    return true;
}

const still_pose_t *poses_stored(void)
{
    return buffer.poses;
}
