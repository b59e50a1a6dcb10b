#include "calibration/fast_code.h"
#include "fusion.h"

FAST_CODE fusion_status_t empty_fusion_predict(fusion_t *state, const fusion_noise_t *noise, const float rate_rad_s[3],
                                               float dt_s)
{
    (void)state;
    (void)noise;
    (void)rate_rad_s;
    (void)dt_s;
    return FUSION_OK;
}

FAST_CODE fusion_status_t empty_fusion_update(fusion_t *state, const fusion_noise_t *noise, const float gravity_g[3],
                                              const float field[3])
{
    (void)state;
    (void)noise;
    (void)gravity_g;
    (void)field;
    return FUSION_OK;
}
