#include "normal_equations.h"

/* For a Cortex-M4 with FPU, normal_equations_m4.S does the same operations in the same order. */
#if !(defined(__ARM_ARCH_7EM__) && defined(__ARM_PCS_VFP))

#include "fast_code.h"

#define UNKNOWNS 9

/* Lower triangle of the normal matrix in rows 0..8, right-hand side in row 9: factoring all ten rows alike also does the
 * forward substitution. */
typedef float augmented_t[UNKNOWNS + 1][UNKNOWNS];

static FAST_CODE void assemble_quadratic(const moments_t *s, augmented_t m)
{
    m[0][0] = (s->xxxx - s->xxzz) - (s->xxzz - s->zzzz);
    m[1][0] = (s->xxyy - s->yyzz) - (s->xxzz - s->zzzz);
    m[1][1] = (s->yyyy - s->yyzz) - (s->yyzz - s->zzzz);
    m[2][0] = s->xxxy - s->xyzz;
    m[2][1] = s->xyyy - s->xyzz;
    m[2][2] = s->xxyy;
    m[3][0] = s->xxxz - s->xzzz;
    m[3][1] = s->xyyz - s->xzzz;
    m[3][2] = s->xxyz;
    m[3][3] = s->xxzz;
    m[4][0] = s->xxyz - s->yzzz;
    m[4][1] = s->yyyz - s->yzzz;
    m[4][2] = s->xyyz;
    m[4][3] = s->xyzz;
    m[4][4] = s->yyzz;
}

static FAST_CODE void assemble_linear(const moments_t *s, augmented_t m)
{
    m[5][0] = s->xxx - s->xzz;
    m[5][1] = s->xyy - s->xzz;
    m[5][2] = s->xxy;
    m[5][3] = s->xxz;
    m[5][4] = s->xyz;
    m[5][5] = s->xx;
    m[6][0] = s->xxy - s->yzz;
    m[6][1] = s->yyy - s->yzz;
    m[6][2] = s->xyy;
    m[6][3] = s->xyz;
    m[6][4] = s->yyz;
    m[6][5] = s->xy;
    m[6][6] = s->yy;
    m[7][0] = s->xxz - s->zzz;
    m[7][1] = s->yyz - s->zzz;
    m[7][2] = s->xyz;
    m[7][3] = s->xzz;
    m[7][4] = s->yzz;
    m[7][5] = s->xz;
    m[7][6] = s->yz;
    m[7][7] = s->zz;
    m[8][0] = s->xx - s->zz;
    m[8][1] = s->yy - s->zz;
    m[8][2] = s->xy;
    m[8][3] = s->xz;
    m[8][4] = s->yz;
    m[8][5] = s->x;
    m[8][6] = s->y;
    m[8][7] = s->z;
    m[8][8] = s->one;
}

/* The right-hand side is -sum(z^2 p); its negative is what the row holds, and its sign is turned when it is divided. */
static FAST_CODE void assemble_target(const moments_t *s, augmented_t m)
{
    m[9][0] = s->xxzz - s->zzzz;
    m[9][1] = s->yyzz - s->zzzz;
    m[9][2] = s->xyzz;
    m[9][3] = s->xzzz;
    m[9][4] = s->yzzz;
    m[9][5] = s->xzz;
    m[9][6] = s->yzz;
    m[9][7] = s->zzz;
    m[9][8] = s->zz;
}

/* Bits of a float. As unsigned numbers they are in the order of positive floats, and those of negative ones, infinity and NaN
 * are larger: one comparison finds the worst of all. */
static inline uint32_t bits(float value)
{
    const union {
        float value;
        uint32_t bits;
    } same = {value};
    return same.bits;
}

/* Factor the first nine rows and carry the tenth along: then row i holds L_ij in column j, and row 9 what L' x is. Stores 1/d_j,
 * and returns the largest M_jj/d_j; of a pivot that vanishes it is infinite, negative, or not a number. */
static FAST_CODE float factor(augmented_t m, float reciprocals[UNKNOWNS])
{
    float diagonal[UNKNOWNS];
    for (int j = 0; j < UNKNOWNS; j++) {
        diagonal[j] = m[j][j];
    }
    float worst = 1.0f; /* that of the first column, which nothing is taken from */
    for (int j = 0; j < UNKNOWNS; j++) {
        const float reciprocal = 1.0f / m[j][j], ratio = diagonal[j] * reciprocal;
        worst = j > 0 && bits(ratio) > bits(worst) ? ratio : worst;
        for (int k = j + 1; k < UNKNOWNS; k++) {
            const float scaled = m[k][j] * reciprocal;
            for (int i = k; i <= UNKNOWNS; i++) {
                m[i][k] -= m[i][j] * scaled;
            }
            m[k][j] = scaled;
        }
        m[UNKNOWNS][j] = -(m[UNKNOWNS][j] * reciprocal);
        reciprocals[j] = reciprocal;
    }
    return bits(worst) < bits(COVERAGE_SINGULAR) ? worst : COVERAGE_SINGULAR;
}

FAST_CODE float quadric_fit(const moments_t *sums, solution_t *solution)
{
    augmented_t m;
    float x[UNKNOWNS]; /* a, b, d, e, f, g, h, i, j; c = 1 - a - b */
    assemble_quadratic(sums, m);
    assemble_linear(sums, m);
    assemble_target(sums, m);
    const float worst = factor(m, solution->pivot_variance);
    if (worst >= COVERAGE_SINGULAR) {
        return worst;
    }
    for (int i = UNKNOWNS - 1; i >= 0; i--) {
        x[i] = m[UNKNOWNS][i];
        for (int k = UNKNOWNS - 1; k > i; k--) {
            x[i] -= m[k][i] * x[k];
        }
    }
    float *const weakest = solution->weakest;
    for (int i = SOLUTION_UNKNOWNS - 1; i >= 0; i--) {
        weakest[i] = m[SOLUTION_UNKNOWNS][i];
        for (int k = SOLUTION_UNKNOWNS - 1; k > i; k--) {
            weakest[i] -= m[k][i] * weakest[k];
        }
    }
    quadric_t *const quadric = &solution->quadric;
    quadric->shape = (symmetric_t){
        .xx = x[0], .xy = 0.5f * x[2], .xz = 0.5f * x[3], .yy = x[1], .yz = 0.5f * x[4], .zz = 1.0f - x[0] - x[1]};
    quadric->linear[0] = x[5];
    quadric->linear[1] = x[6];
    quadric->linear[2] = x[7];
    quadric->constant = x[8];
    return worst;
}

#endif
