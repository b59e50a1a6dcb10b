#include "point_packing.h"

#include <stddef.h>

#include "calibration/point_range.h"
#include "timed_run.h"

static packed_points_t packed;
static bool is_packing; /* points that are stored */

void point_packing_start(const int16_t centre[3])
{
    const int32_t anchor[3] = {centre[0], centre[1], centre[2]};
    packed_points_start(&packed, anchor);
    is_packing = true;
}

/* One that is too far away to be packed is missing, and so are all after it. */
void point_packing_store(uint16_t index, const int16_t point[3])
{
    if (is_packing && packed.block.count == index) {
        (void)packed_points_add(&packed, point);
    }
}

packing_cost_t point_packing_run(const magnetometer_points_t *points, const int16_t centre[3])
{
    packing_cost_t total = {0};
    point_range_t range;
    stream_status_t status;
    point_packing_start(centre);
    is_packing = false;
    point_range_start(&range, points->points[0]);
    for (uint16_t i = 0; i < points->count; i++) {
        const run_cost_t keeping = timed_step(point_range_add, &range, points->points[i], &status);
        const run_cost_t packing = timed_step(packed_points_add, &packed, points->points[i], &status);
        total.range_cycles += keeping.cycles;
        total.packing_cycles += packing.cycles;
        total.overhead_cycles += packing.overhead_cycles;
    }
    return total;
}

packed_points_t *point_packing_of(uint16_t count)
{
    return packed.block.count == count ? &packed : NULL;
}

void point_packing_forget(void)
{
    packed.block.count = 0;
    is_packing = false;
}
