/**
 * @file gauss_newton.c
 * @brief `gauss-newton`: plain Gauss-Newton steps on the calibrated norm, from the sphere.
 *
 * Mucciaccia's thesis (2020), section 4.4, names the algorithm and the metric `|C (p - o)| - 1`, C symmetric, and no equations. Each step
 * solves `J step = -r` by least squares: here by the normal equations, whose 54 sums each step takes of all points anew. That they square
 * the condition costs nothing where the steps end: what they solve for is then zero. Nothing damps the steps and nothing bounds them.
 *
 * Spheres that grow and go away have norms ever nearer to 1, whatever the points: a centre that is far off, or a flat ellipsoid, is no
 * minimum. Coverage is judged as in direct.c, by the pivots; the float64 reference judges it by the condition number.
 */
#include "closed_form.h"
#include "fast_code.h"
#include "unit_trace_products.h"

#define UNKNOWNS UNIT_TRACE_UNKNOWNS

/* As in the float64 reference. With 0.3 uT of noise 3 to 9 are taken, with 2.5 uT up to 38. */
#define STEPS 100

/* Largest change of a parameter, all of which are of size 1, that ends the steps: with 2.5 uT of noise 0.001 degrees are left at most. */
#define SETTLED 5.0e-6f

/* Parameters this large have run away. */
#define RUN_AWAY 1.0e6f

/* From the mean of the points, in rms distances from it. */
#define FURTHEST_CENTRE 3.0f

#define SMALLEST_NORM 1.0e-12f

/** Where the points are, and what they are divided by. */
typedef struct {
    int32_t anchor[3]; /**< [counts] */
    float unit;        /**< rms distance from the mean [counts] */
    float mean[3];     /**< relative to the anchor [units] */
} frame_t;

/* Parameters: the centre o relative to the anchor [units], then C's elements xx, xy, xz, yy, yz, zz [1/unit]. */

#if defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP)
/* A point's row stays in s0 to s8, the error in s27. Of each row of sums what is needed is loaded and stored together: 54 sums take 260
 * cycles so, and 580 as the compiler does it. */
#define ADD_1 "vadd.f32 s9, s9, s18\n\t"
#define ADD_2 ADD_1 "vadd.f32 s10, s10, s19\n\t"
#define ADD_3 ADD_2 "vadd.f32 s11, s11, s20\n\t"
#define ADD_4 ADD_3 "vadd.f32 s12, s12, s21\n\t"
#define ADD_5 ADD_4 "vadd.f32 s13, s13, s22\n\t"
#define ADD_6 ADD_5 "vadd.f32 s14, s14, s23\n\t"
#define ADD_7 ADD_6 "vadd.f32 s15, s15, s24\n\t"
#define ADD_8 ADD_7 "vadd.f32 s16, s16, s25\n\t"
#define ADD_9 ADD_8 "vadd.f32 s17, s17, s26\n\t"
#define MULTIPLY_1(by) "vmul.f32 s18, " by ", s0\n\t"
#define MULTIPLY_2(by) MULTIPLY_1(by) "vmul.f32 s19, " by ", s1\n\t"
#define MULTIPLY_3(by) MULTIPLY_2(by) "vmul.f32 s20, " by ", s2\n\t"
#define MULTIPLY_4(by) MULTIPLY_3(by) "vmul.f32 s21, " by ", s3\n\t"
#define MULTIPLY_5(by) MULTIPLY_4(by) "vmul.f32 s22, " by ", s4\n\t"
#define MULTIPLY_6(by) MULTIPLY_5(by) "vmul.f32 s23, " by ", s5\n\t"
#define MULTIPLY_7(by) MULTIPLY_6(by) "vmul.f32 s24, " by ", s6\n\t"
#define MULTIPLY_8(by) MULTIPLY_7(by) "vmul.f32 s25, " by ", s7\n\t"
#define MULTIPLY_9(by) MULTIPLY_8(by) "vmul.f32 s26, " by ", s8\n\t"
#define SUMS(count, row, by)                                                                                                         \
    "vldmia %[sums], {" row "}\n\t" MULTIPLY_##count(by) ADD_##count "vstmia %[sums], {" row "}\n\tadd %[sums], #40\n\t"

_Static_assert(sizeof(products_t) == 10u * 40u, "SUMS goes down the rows in steps of one");

/* Add one point's row, the derivatives of its norm and the norm's error, to the lower triangle. */
static inline __attribute__((always_inline)) void add_row(const float row[UNKNOWNS + 1], products_t m)
{
    float *sums = &m[0][0];
    __asm__ volatile("vldmia %[row], {s0-s8}\n\tvldr s27, [%[row], #36]\n\t"
                     SUMS(1, "s9", "s0") SUMS(2, "s9-s10", "s1") SUMS(3, "s9-s11", "s2") SUMS(4, "s9-s12", "s3")
                     SUMS(5, "s9-s13", "s4") SUMS(6, "s9-s14", "s5") SUMS(7, "s9-s15", "s6") SUMS(8, "s9-s16", "s7")
                     SUMS(9, "s9-s17", "s8") SUMS(9, "s9-s17", "s27")
                     : [sums] "+r"(sums)
                     : [row] "r"(row)
                     : "s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11", "s12", "s13", "s14", "s15", "s16",
                       "s17", "s18", "s19", "s20", "s21", "s22", "s23", "s24", "s25", "s26", "s27", "memory");
}
#else
static inline void add_row(const float row[UNKNOWNS + 1], products_t m)
{
    for (int i = 0; i <= UNKNOWNS; i++) {
        for (int j = 0; j <= i && j < UNKNOWNS; j++) {
            m[i][j] += row[i] * row[j];
        }
    }
}
#endif

static FAST_CODE void normal_equations(const magnetometer_points_t *points, const frame_t *frame, const float p[UNKNOWNS],
                                       products_t m)
{
    const float scale = 1.0f / frame->unit;
    for (int i = 0; i <= UNKNOWNS; i++) {
        for (int j = 0; j <= UNKNOWNS; j++) {
            m[i][j] = 0.0f;
        }
    }
    for (uint32_t at = 0; at < points->count; at++) {
        const int16_t *const point = points->points[at];
        const float x = scale * (float)(point[0] - frame->anchor[0]) - p[0];
        const float y = scale * (float)(point[1] - frame->anchor[1]) - p[1];
        const float z = scale * (float)(point[2] - frame->anchor[2]) - p[2];
        const float ux = p[3] * x + p[4] * y + p[5] * z;
        const float uy = p[4] * x + p[6] * y + p[7] * z;
        const float uz = p[5] * x + p[7] * y + p[8] * z;
        const float norm = __builtin_sqrtf(ux * ux + uy * uy + uz * uz);
        const float reciprocal = 1.0f / (norm > SMALLEST_NORM ? norm : SMALLEST_NORM);
        const float nx = reciprocal * ux, ny = reciprocal * uy, nz = reciprocal * uz;
        const float row[UNKNOWNS + 1] = {
            -(p[3] * nx + p[4] * ny + p[5] * nz),
            -(p[4] * nx + p[6] * ny + p[7] * nz),
            -(p[5] * nx + p[7] * ny + p[8] * nz),
            nx * x,
            nx * y + ny * x,
            nx * z + nz * x,
            ny * y,
            ny * z + nz * y,
            nz * z,
            norm - 1.0f,
        };
        add_row(row, m);
    }
}

/* Take a step; returns its largest element, or infinity when there is none to take. */
static FAST_CODE float take_step(const magnetometer_points_t *points, const frame_t *frame, float p[UNKNOWNS])
{
    products_t m;
    float step[UNKNOWNS + 1];
    float largest = 0.0f, size = 0.0f;
    normal_equations(points, frame, p, m);
    if (!products_eliminate(m, 0, UNKNOWNS)) {
        return __builtin_huge_valf();
    }
    step[UNKNOWNS] = 1.0f;
    products_substitute(m, 0, UNKNOWNS, step);
    for (int i = 0; i < UNKNOWNS; i++) {
        p[i] += step[i];
        size = __builtin_fabsf(p[i]) < size ? size : __builtin_fabsf(p[i]);
        largest = __builtin_fabsf(step[i]) < largest ? largest : __builtin_fabsf(step[i]);
    }
    return size < RUN_AWAY ? largest : __builtin_huge_valf(); /* of NaN, too */
}

/* Say whether the parameters are a calibration, and of which ellipsoid: with either sign of C norms are the same. */
static FAST_CODE bool is_ellipsoid(const frame_t *frame, const float p[UNKNOWNS], quadric_t *quadric, ellipsoid_t *ellipsoid)
{
    float away = 0.0f;
    for (int axis = 0; axis < 3; axis++) {
        const float distance = p[axis] - frame->mean[axis];
        away += distance * distance;
    }
    const symmetric_t square = {
        .xx = p[3] * p[3] + p[4] * p[4] + p[5] * p[5],
        .xy = p[3] * p[4] + p[4] * p[6] + p[5] * p[7],
        .xz = p[3] * p[5] + p[4] * p[7] + p[5] * p[8],
        .yy = p[4] * p[4] + p[6] * p[6] + p[7] * p[7],
        .yz = p[4] * p[5] + p[6] * p[7] + p[7] * p[8],
        .zz = p[5] * p[5] + p[7] * p[7] + p[8] * p[8],
    };
    const float scale = 1.0f / (square.xx + square.yy + square.zz);
    quadric->shape = (symmetric_t){scale * square.xx, scale * square.xy, scale * square.xz,
                                   scale * square.yy, scale * square.yz, scale * square.zz};
    quadric->linear[0] = quadric->linear[1] = quadric->linear[2] = 0.0f;
    quadric->constant = -(frame->unit * frame->unit * scale);
    if (!(away < FURTHEST_CENTRE * FURTHEST_CENTRE) || !quadric_ellipsoid(quadric, ellipsoid)) {
        return false;
    }
    for (int axis = 0; axis < 3; axis++) {
        ellipsoid->centre[axis] = frame->unit * p[axis];
    }
    return true;
}

FAST_CODE void magnetometer_gauss_newton(const magnetometer_points_t *points, magnetometer_fit_t *fit)
{
    frame_t frame;
    moments_t sums;
    sphere_t sphere;
    solution_t solution;
    quadric_t quadric;
    ellipsoid_t ellipsoid;
    float p[UNKNOWNS];

    fit->iterations = 0;
    fit->coverage = 0.0f;
    if (points->count < FIT_ELLIPSOID_UNKNOWNS) {
        fit_nothing(FIT_TOO_FEW_POINTS, fit);
        return;
    }
    moments_anchor(points, frame.anchor);
    moments_sum(points, frame.anchor, &sums);
    if (!fit_ellipsoid(&sums, BIAS_OF_LEAST_SQUARES, &solution, &ellipsoid, fit)) {
        return;
    }
    if (!sphere_from_moments(&sums, &sphere)) {
        fit_nothing(FIT_SINGULAR, fit);
        return;
    }
    const float share = 1.0f / sums.one;
    const float mean[3] = {share * sums.x, share * sums.y, share * sums.z};
    const float square = mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2];
    frame.unit = __builtin_sqrtf(share * (sums.xx + sums.yy + sums.zz) - square);
    const float scale = 1.0f / frame.unit;
    for (int axis = 0; axis < 3; axis++) {
        frame.mean[axis] = scale * mean[axis];
        p[axis] = scale * sphere.centre[axis];
    }
    p[3] = p[6] = p[8] = frame.unit / __builtin_sqrtf(sphere.square);
    p[4] = p[5] = p[7] = 0.0f;

    const uint16_t limit = points->iterations == 0u || points->iterations > STEPS ? STEPS : points->iterations;
    float step = __builtin_huge_valf();
    while (fit->iterations < limit && !(step < SETTLED)) {
        step = take_step(points, &frame, p);
        fit->iterations++;
        if (!(step < RUN_AWAY)) {
            break;
        }
    }
    if (!(step < RUN_AWAY) || !is_ellipsoid(&frame, p, &quadric, &ellipsoid)) {
        fit_nothing(FIT_NOT_AN_ELLIPSOID, fit);
        return;
    }
    fit_calibration(&quadric, &ellipsoid, frame.anchor, step < SETTLED ? FIT_ELLIPSOID : FIT_NOT_CONVERGED, fit);
}
