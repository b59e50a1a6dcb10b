#include "attitude_filter.h"
#include "calibration/fast_code.h"

FAST_CODE attitude_filter_status_t empty_attitude_filter_update(attitude_filter_t *state, const float rate_rad_s[3],
                                                                const float gravity_g[3], const float field[3], float dt_s)
{
    (void)state;
    (void)rate_rad_s;
    (void)gravity_g;
    (void)field;
    (void)dt_s;
    return ATTITUDE_FILTER_OK;
}
