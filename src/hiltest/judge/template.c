/* A calibrator for `hiltest judge`: the middle and the width of the samples' range, as many tutorials have it. */
#include "hiltest_judge.h"

int calibrate(const float samples[][3], int n, float hard_iron[3], float soft_iron[3][3])
{
    for (int axis = 0; axis < 3; axis++) {
        float low = samples[0][axis], high = samples[0][axis];
        for (int i = 1; i < n; i++) {
            low = samples[i][axis] < low ? samples[i][axis] : low;
            high = samples[i][axis] > high ? samples[i][axis] : high;
        }
        hard_iron[axis] = 0.5f * (low + high);
        for (int other = 0; other < 3; other++)
            soft_iron[axis][other] = 0.0f;
        soft_iron[axis][axis] = 2.0f / (high - low);
    }
    return 0;
}
