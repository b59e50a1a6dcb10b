#include "normal_equations.h"

#include "fast_code.h"

#define UNKNOWNS 9

/* Lower triangle of the normal matrix in rows 0..8, right-hand side in row 9: factoring all ten rows alike also does the
 * forward substitution. */
typedef float augmented_t[UNKNOWNS + 1][UNKNOWNS];

static inline __attribute__((always_inline)) void assemble_quadratic(const moments_t *s, augmented_t m)
{
    m[0][0] = s->xxxx - 2.0f * s->xxzz + s->zzzz;
    m[1][0] = s->xxyy - s->xxzz - s->yyzz + s->zzzz;
    m[1][1] = s->yyyy - 2.0f * s->yyzz + s->zzzz;
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

static inline __attribute__((always_inline)) void assemble_linear(const moments_t *s, augmented_t m)
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

/* The right-hand side is -sum(z^2 p); its negative is what the rows hold, and the solution's sign is turned at the end. */
static inline __attribute__((always_inline)) void assemble_target(const moments_t *s, augmented_t m)
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

/* Subtract from columns 0..first-1 of rows first..last what earlier columns explain, all these rows together so that each
 * element of L is loaded once. Row i then holds L_ij d_j in column j. */
static inline __attribute__((always_inline)) void reduce_rows(augmented_t m, int first, int last)
{
#pragma GCC unroll 9
    for (int j = 1; j < first; j++) {
#pragma GCC unroll 9
        for (int k = 0; k < j; k++) {
#pragma GCC unroll 9
            for (int i = first; i <= last; i++) {
                m[i][j] -= m[i][k] * m[j][k];
            }
        }
    }
}

/* Finish row j: replace its L_jk d_k by L_jk, form the pivot and its reciprocal, and reduce column j of the rows below it down
 * to `last`. Returns M_jj/d_j; for a pivot that vanishes that is infinite, negative, or not a number. */
static inline __attribute__((always_inline)) float finish_row(augmented_t m, float reciprocal[UNKNOWNS], int j, int last)
{
    const float diagonal = m[j][j];
    float pivot = diagonal;
#pragma GCC unroll 9
    for (int k = 0; k < j; k++) {
        const float scaled = m[j][k] * reciprocal[k];
        pivot -= m[j][k] * scaled;
        m[j][k] = scaled;
#pragma GCC unroll 9
        for (int i = j + 1; i <= last; i++) {
            m[i][j] -= m[i][k] * scaled;
        }
    }
    reciprocal[j] = 1.0f / pivot;
    return diagonal * reciprocal[j];
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

/* Factor the first nine rows and carry the tenth along, in three blocks whose rows fit the registers. Every loop is unrolled
 * completely: a rolled triangle spends more on indices than on arithmetic. Returns the largest M_jj/d_j, at most
 * COVERAGE_SINGULAR, at which the factors mean nothing. */
static inline __attribute__((always_inline)) float factor(augmented_t m, float reciprocal[UNKNOWNS])
{
    float worst = 1.0f;
#pragma GCC unroll 9
    for (int j = 0; j < UNKNOWNS; j++) {
        const int last = j < 3 ? 2 : j < 6 ? 5 : UNKNOWNS;
        if (j == 3 || j == 6) {
            reduce_rows(m, j, last);
        }
        const float ratio = finish_row(m, reciprocal, j, last);
        worst = bits(ratio) > bits(worst) ? ratio : worst;
    }
    return bits(worst) < bits(COVERAGE_SINGULAR) ? worst : COVERAGE_SINGULAR;
}

FAST_CODE float quadric_fit(const moments_t *sums, quadric_t *quadric)
{
    augmented_t m;
    float reciprocal[UNKNOWNS] = {0};
    float t[UNKNOWNS];
    assemble_quadratic(sums, m);
    assemble_linear(sums, m);
    assemble_target(sums, m);
    const float worst = factor(m, reciprocal);
    if (worst >= COVERAGE_SINGULAR) {
        return worst;
    }
#pragma GCC unroll 9
    for (int i = UNKNOWNS - 1; i >= 0; i--) {
        t[i] = m[UNKNOWNS][i] * reciprocal[i];
#pragma GCC unroll 9
        for (int k = UNKNOWNS - 1; k > i; k--) {
            t[i] -= m[k][i] * t[k];
        }
    }
    /* The tenth row held -w, so t is minus the solution (a, b, d, e, f, g, h, i, j), and c = 1 - a - b. */
    quadric->shape = (symmetric_t){.xx = -t[0],
                                   .xy = -0.5f * t[2],
                                   .xz = -0.5f * t[3],
                                   .yy = -t[1],
                                   .yz = -0.5f * t[4],
                                   .zz = 1.0f + t[0] + t[1]};
    quadric->linear[0] = -t[5];
    quadric->linear[1] = -t[6];
    quadric->linear[2] = -t[7];
    quadric->constant = -t[8];
    return worst;
}
