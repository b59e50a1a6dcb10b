/**
 * @file dpi_commands.c
 * @brief FIT_DPI.
 */
#include <math.h>

#include "calibration/fast_code.h"
#include "calibration/joint.h"
#include "calibration_slots.h"
#include "command.h"
#include "fit_fields.h"
#include "points_buffer.h"
#include "pose_buffer.h"
#include "timed_run.h"

#define DEGREES_PER_RADIAN 57.29577951f
#define FLAG_DIP_GIVEN 0x01u
#define FLAG_JOINT 0x02u

enum { SOURCE_PAIRS = 0, SOURCE_POSES = 1 };

typedef struct {
    dpi_pairs_t pairs;
    dpi_poses_t poses;
    dpi_known_t known;
} dpi_task_t;

static FAST_CODE void fit_pairs(const void *task, void *result)
{
    const dpi_task_t *const it = task;
    dpi_from_pairs(&it->pairs, &it->known, result);
}

static FAST_CODE void fit_jointly(const void *task, void *result)
{
    const dpi_task_t *const it = task;
    joint_from_pairs(&it->pairs, &it->known, result);
}

static FAST_CODE void fit_poses(const void *task, void *result)
{
    const dpi_task_t *const it = task;
    dpi_from_poses(&it->poses, &it->known, result);
}

/** The field by the data: dip [deg], and strength as the sensor shows it [counts]; NaN if the data do not determine it. */
static void write_estimates(payload_writer_t *reply, const dpi_known_t *known, bool is_joint, const dpi_fit_t *result)
{
    const float *const c = result->fit.soft_iron;
    const bool has_fit = result->fit.status == FIT_ELLIPSOID;
    float strength = NAN;
    if (has_fit) {
        const float determinant = c[0] * (c[4] * c[8] - c[5] * c[7]) - c[1] * (c[3] * c[8] - c[5] * c[6]) +
                                  c[2] * (c[3] * c[7] - c[4] * c[6]);
        /* The dip that was given may have scaled soft_iron of `dpi`; the points' norms are what the data say. */
        const float scale = known->dip_is_given != 0u && !is_joint ? known->sine / result->sine : 1.0f;
        strength = scale / cbrtf(determinant);
    }
    write_u16(reply, result->used);
    write_f32(reply, result->sine != 0.0f ? asinf(fmaxf(-1.0f, fminf(1.0f, result->sine))) * DEGREES_PER_RADIAN : NAN);
    write_f32(reply, strength);
    write_f32(reply, result->sine != 0.0f ? result->standard_error : NAN);
}

status_t command_fit_dpi(payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t source = read_u8(request);
    const uint16_t count = read_u16(request);
    const uint8_t slot = read_u8(request);
    const uint8_t flags = read_u8(request);
    const bool is_joint = (flags & FLAG_JOINT) != 0u;
    const float dip_deg = read_f32(request);
    if (source > SOURCE_POSES || count == 0u || slot >= SLOT_COUNT || flags > (FLAG_DIP_GIVEN | FLAG_JOINT) ||
        (is_joint && source != SOURCE_PAIRS) || !(fabsf(dip_deg) <= 90.0f)) {
        return STATUS_BAD_ARGUMENT;
    }
    if (count > (source == SOURCE_PAIRS ? points_count() : poses_count())) {
        return STATUS_TOO_FEW_POINTS;
    }
    dpi_task_t task = {
        .poses = {.poses = poses_stored(), .count = count},
        .known = {.accelerometer = *slot_accelerometer(slot),
                  .sine = sinf(dip_deg / DEGREES_PER_RADIAN),
                  .dip_is_given = (flags & FLAG_DIP_GIVEN) != 0u},
    };
    if (source == SOURCE_PAIRS) {
        task.pairs = pairs_first(count);
    }
    dpi_fit_t result;
    const run_cost_t cost = timed_work(is_joint ? fit_jointly : source == SOURCE_PAIRS ? fit_pairs : fit_poses, &task, &result);
    write_fit(reply, &result.fit, 0);
    write_estimates(reply, &task.known, is_joint, &result);
    write_u32(reply, cost.cycles);
    write_u32(reply, cost.overhead_cycles);
    return timed_run_has_counter() ? STATUS_OK : STATUS_NO_CYCLE_COUNTER;
}
