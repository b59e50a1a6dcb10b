/* Instances of the thesis' generator, and the quadric fit of `direct`, four instances to a vector.

   The instances are those of instances.py to the last bit: Philox by counter, tables of quantiles and cosines that both
   are given, and of arithmetic only what IEEE 754 rounds in one way (+ - * / sqrt, none contracted to an fma). The
   vectors are GCC's, which any processor has; where it has AVX2, the same source runs on that. */

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O3", "no-math-errno") /* whole loops unrolled; no result changes */
#endif

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

enum { LANES = 4, UNKNOWNS = 9, WORDS = 4, PARAMETER_COUNTERS = 3, PARAMETER_WORDS = WORDS * PARAMETER_COUNTERS };

typedef double lanes __attribute__((vector_size(LANES * sizeof(double))));
typedef double unaligned __attribute__((vector_size(LANES * sizeof(double)), aligned(sizeof(double)), may_alias));
__extension__ typedef unsigned __int128 wide;

#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__)
#define BY_PROCESSOR __attribute__((target_clones("avx2", "default")))
#else
#define BY_PROCESSOR
#endif

#define INLINE static inline __attribute__((always_inline))

/* `Model` of instances.py. */
struct model {
    uint64_t seed, stream, points;
    double field, hard_iron, stretch, occluded, noise;
    const double *quantiles, *cosines; /* of 65 536 intervals, and of as many parts of a turn */
};

struct quadrics {
    lanes shape[6], centre[3], level; /* xx yy zz xy xz yz */
};

const char *hiltest_source(void) { return HILTEST_SOURCE_SHA256; }

/* Philox 4x64-10 (Salmon et al., SC'11). */
static void philox(const struct model *model, uint64_t counter, uint64_t words[WORDS])
{
    uint64_t a = counter, b = model->stream, c = model->points, d = 0, key0 = model->seed, key1 = 0;
    for (int round = 0; round < 10; round++) {
        wide first = (wide)UINT64_C(0xD2E7470EE14C6C93) * a, second = (wide)UINT64_C(0xCA5A826395121157) * c;
        a = (uint64_t)(second >> 64) ^ b ^ key0;
        b = (uint64_t)second;
        c = (uint64_t)(first >> 64) ^ d ^ key1;
        d = (uint64_t)first;
        key0 += UINT64_C(0x9E3779B97F4A7C15);
        key1 += UINT64_C(0xBB67AE8584CAA73B);
    }
    words[0] = a, words[1] = b, words[2] = c, words[3] = d;
}

static double uniform(uint64_t word) { return (double)(word >> 11) * 0x1p-53; }

static void rotation(const struct model *model, uint64_t word, double r[3][3])
{
    double w = model->quantiles[word & 0xFFFF], x = model->quantiles[word >> 16 & 0xFFFF];
    double y = model->quantiles[word >> 32 & 0xFFFF], z = model->quantiles[word >> 48];
    double norm = sqrt(w * w + x * x + y * y + z * z);
    w = w / norm, x = x / norm, y = y / norm, z = z / norm;
    r[0][0] = 1.0 - 2.0 * (y * y + z * z), r[0][1] = 2.0 * (x * y - w * z), r[0][2] = 2.0 * (x * z + w * y);
    r[1][0] = 2.0 * (x * y + w * z), r[1][1] = 1.0 - 2.0 * (x * x + z * z), r[1][2] = 2.0 * (y * z - w * x);
    r[2][0] = 2.0 * (x * z - w * y), r[2][1] = 2.0 * (y * z + w * x), r[2][2] = 1.0 - 2.0 * (x * x + y * y);
}

/* Draws one instance; axis a of point i goes to points[stride * (3 * i + a)]. */
static void draw(const struct model *model, uint64_t instance, double *points, size_t stride)
{
    uint64_t n = model->points, of_points = (n + 3) / 4, of_heights = (n + 7) / 8;
    uint64_t counter = instance * (PARAMETER_COUNTERS + of_points + of_heights) + 1;
    uint64_t given[PARAMETER_WORDS], words[WORDS], heights[WORDS] = {0};
    for (uint64_t k = 0; k < PARAMETER_COUNTERS; k++)
        philox(model, counter + k, given + WORDS * k);
    counter += PARAMETER_COUNTERS;

    double axes[3][3], cap[3][3], across[3][3], centre[3];
    rotation(model, given[7], axes);
    rotation(model, given[8], cap);
    double low = 1.0 - model->stretch, width = 2.0 * model->stretch;
    double e0 = low + width * uniform(given[0]), e1 = low + width * uniform(given[1]);
    double e2 = low + width * uniform(given[2]);
    for (int i = 0; i < 3; i++) {
        double iron[3];
        for (int j = 0; j < 3; j++)
            iron[j] = axes[i][0] * e0 * axes[j][0] + axes[i][1] * e1 * axes[j][1] + axes[i][2] * e2 * axes[j][2];
        for (int j = 0; j < 3; j++)
            across[i][j] = model->field * (iron[0] * cap[0][j] + iron[1] * cap[1][j] + iron[2] * cap[2][j]);
        centre[i] = 2.0 * model->hard_iron * uniform(given[3 + i]) - model->hard_iron;
    }
    double seen = 2.0 - 2.0 * (model->occluded * uniform(given[6]));

    for (uint64_t k = 0; k < n; k++) {
        if (k % WORDS == 0)
            philox(model, counter + k / WORDS, words);
        if (k % (2 * WORDS) == 0)
            philox(model, counter + of_points + k / (2 * WORDS), heights);
        uint64_t word = words[k % WORDS], height = heights[k % (2 * WORDS) / 2] >> (k % 2 * 32) & 0xFFFFFFFF;
        double z = seen * (((double)height + 0.5) * 0x1p-32) - 1.0;
        double r = sqrt(1.0 - z * z);
        double x = r * model->cosines[word >> 48], y = r * model->cosines[((word >> 48) - 16384) & 0xFFFF];
        for (int a = 0; a < 3; a++) {
            double noise = model->noise * model->quantiles[word >> (16 * a) & 0xFFFF];
            points[stride * (3 * k + (size_t)a)] =
                across[a][0] * x + across[a][1] * y + across[a][2] * z + centre[a] + noise;
        }
    }
}

/* The sums of products of points about their mean, as the rows of [[M, w], [w', .]] of `fit_direct`. Three times over
   the points, so that the sums of each time stay in registers; the first leaves them about their mean, by which the
   sums of the points themselves are 0. */
INLINE void normal_equations(lanes *points, size_t n, const lanes mean[3], lanes m[UNKNOWNS][UNKNOWNS + 1])
{
    lanes xx = {0}, yy = {0}, zz = {0}, xy = {0}, xz = {0}, yz = {0}, x3 = {0}, y3 = {0}, z3 = {0}, xyz = {0};
    for (size_t i = 0; i < 3 * n; i += 3) {
        lanes x = points[i] - mean[0], y = points[i + 1] - mean[1], z = points[i + 2] - mean[2];
        lanes a = x * x, b = y * y, c = z * z, d = x * y;
        points[i] = x, points[i + 1] = y, points[i + 2] = z;
        xx += a, yy += b, zz += c, xy += d, xz += x * z, yz += y * z;
        x3 += a * x, y3 += b * y, z3 += c * z, xyz += d * z;
    }
    lanes x2y = {0}, x2z = {0}, y2x = {0}, y2z = {0}, z2x = {0}, z2y = {0}, x4 = {0}, y4 = {0}, z4 = {0};
    for (size_t i = 0; i < 3 * n; i += 3) {
        lanes x = points[i], y = points[i + 1], z = points[i + 2], a = x * x, b = y * y, c = z * z;
        x2y += a * y, x2z += a * z, y2x += b * x, y2z += b * z, z2x += c * x, z2y += c * y;
        x4 += a * a, y4 += b * b, z4 += c * c;
    }
    lanes x3y = {0}, x3z = {0}, y3x = {0}, y3z = {0}, z3x = {0}, z3y = {0};
    lanes x2y2 = {0}, x2z2 = {0}, y2z2 = {0}, x2yz = {0}, y2xz = {0}, z2xy = {0};
    for (size_t i = 0; i < 3 * n; i += 3) {
        lanes x = points[i], y = points[i + 1], z = points[i + 2];
        lanes a = x * x, b = y * y, c = z * z, d = x * y, e = x * z, f = y * z;
        x3y += a * d, x3z += a * e, y3x += b * d, y3z += b * f, z3x += c * e, z3y += c * f;
        x2y2 += a * b, x2z2 += a * c, y2z2 += b * c, x2yz += a * f, y2xz += b * e, z2xy += c * d;
    }
    const lanes none = {0};
    lanes count = (lanes){0} + (double)n;
    const lanes rows[UNKNOWNS][UNKNOWNS + 1] = {
        {x4 - 2.0 * x2z2 + z4, x2y2 - x2z2 - y2z2 + z4, x3y - z2xy, x3z - z3x, x2yz - z3y, x3 - z2x, x2y - z2y,
         x2z - z3, xx - zz, z4 - x2z2},
        {[1] = y4 - 2.0 * y2z2 + z4, y3x - z2xy, y2xz - z3x, y3z - z3y, y2x - z2x, y3 - z2y, y2z - z3, yy - zz,
         z4 - y2z2},
        {[2] = x2y2, x2yz, y2xz, x2y, y2x, xyz, xy, -z2xy},
        {[3] = x2z2, z2xy, x2z, xyz, z2x, xz, -z3x},
        {[4] = y2z2, xyz, y2z, z2y, yz, -z3y},
        {[5] = xx, xy, xz, none, -z2x},
        {[6] = yy, yz, none, -z2y},
        {[7] = zz, none, -z3},
        {[8] = count, -zz},
    };
    for (int i = 0; i < UNKNOWNS; i++)
        for (int j = i; j <= UNKNOWNS; j++)
            m[i][j] = rows[i][j];
}

/* Solves by L D L'. A pivot of 0 leaves what is not finite, which no comparison takes for an ellipsoid. */
INLINE void solve(lanes m[UNKNOWNS][UNKNOWNS + 1], lanes theta[UNKNOWNS])
{
    for (int i = 0; i < UNKNOWNS; i++) {
        lanes inverse = 1.0 / m[i][i];
        for (int k = i + 1; k < UNKNOWNS; k++) {
            lanes factor = m[i][k] * inverse;
            for (int j = k; j <= UNKNOWNS; j++)
                m[k][j] -= factor * m[i][j];
        }
        for (int j = i + 1; j <= UNKNOWNS; j++)
            m[i][j] *= inverse;
    }
    for (int i = UNKNOWNS - 1; i >= 0; i--) {
        theta[i] = m[i][UNKNOWNS];
        for (int j = i + 1; j < UNKNOWNS; j++)
            theta[i] -= m[i][j] * theta[j];
    }
}

/* Leaves the points about their mean. */
BY_PROCESSOR static void fit(lanes *points, size_t n, struct quadrics *found)
{
    lanes mean[3] = {{0}}, m[UNKNOWNS][UNKNOWNS + 1], theta[UNKNOWNS];
    for (size_t i = 0; i < 3 * n; i += 3)
        for (size_t a = 0; a < 3; a++)
            mean[a] += points[i + a];
    for (size_t a = 0; a < 3; a++)
        mean[a] /= (double)n;
    normal_equations(points, n, mean, m);
    solve(m, theta);
    lanes a = theta[0], b = theta[1], c = 1.0 - a - b;
    lanes d = 0.5 * theta[2], e = 0.5 * theta[3], f = 0.5 * theta[4], *g = theta + 5;
    lanes aa = b * c - f * f, dd = e * f - c * d, ee = d * f - b * e, bb = a * c - e * e, ff = d * e - a * f;
    lanes cc = a * b - d * d, half = -0.5 / (a * aa + d * dd + e * ee);
    lanes x = half * (aa * g[0] + dd * g[1] + ee * g[2]), y = half * (dd * g[0] + bb * g[1] + ff * g[2]);
    lanes z = half * (ee * g[0] + ff * g[1] + cc * g[2]);
    *found = (struct quadrics){
        {a, b, c, d, e, f}, {mean[0] + x, mean[1] + y, mean[2] + z},
        -0.5 * (x * g[0] + y * g[1] + z * g[2]) - theta[8],
    };
}

/* Sylvester's criterion, and a positive level. */
static int is_ellipsoid(const struct quadrics *found, int lane)
{
    double a = found->shape[0][lane], b = found->shape[1][lane], c = found->shape[2][lane];
    double d = found->shape[3][lane], e = found->shape[4][lane], f = found->shape[5][lane];
    double second = a * b - d * d, third = second * c - (a * f * f - 2.0 * d * e * f + b * e * e);
    return a > 0.0 && second > 0.0 && third > 0.0 && found->level[lane] > 0.0;
}

/* Coordinates of four instances into the lanes of vectors: four by four, transposed. */
BY_PROCESSOR static void side_by_side(const double *const from[LANES], size_t count, lanes *into)
{
    size_t i = 0;
    for (; i + LANES <= count; i += LANES) {
        lanes rows[LANES];
        for (int lane = 0; lane < LANES; lane++)
            rows[lane] = *(const unaligned *)(from[lane] + i);
        lanes a = __builtin_shufflevector(rows[0], rows[1], 0, 4, 2, 6);
        lanes b = __builtin_shufflevector(rows[0], rows[1], 1, 5, 3, 7);
        lanes c = __builtin_shufflevector(rows[2], rows[3], 0, 4, 2, 6);
        lanes d = __builtin_shufflevector(rows[2], rows[3], 1, 5, 3, 7);
        into[i] = __builtin_shufflevector(a, c, 0, 1, 4, 5);
        into[i + 1] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
        into[i + 2] = __builtin_shufflevector(a, c, 2, 3, 6, 7);
        into[i + 3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
    }
    for (; i < count; i++)
        into[i] = (lanes){from[0][i], from[1][i], from[2][i], from[3][i]};
}

static lanes *room_for(size_t n) { return aligned_alloc(sizeof(lanes), 3 * n * sizeof(lanes)); }

/* Instances `first` and the `count` - 1 after it, as rows of three. */
void hiltest_draw(const struct model *model, uint64_t first, uint64_t count, double *points)
{
    for (uint64_t k = 0; k < count; k++)
        draw(model, first + k, points + 3 * model->points * k, 1);
}

/* How many of them are fitted by something else than an ellipsoid; -1 without memory. */
int64_t hiltest_non_ellipsoids(const struct model *model, uint64_t first, uint64_t count)
{
    lanes *points = room_for(model->points);
    int64_t others = 0;
    if (points == NULL)
        return -1;
    for (uint64_t k = 0; k < count; k += LANES) {
        struct quadrics found;
        for (uint64_t lane = 0; lane < LANES; lane++)
            draw(model, first + (k + lane < count ? k + lane : k), (double *)points + lane, LANES);
        fit(points, model->points, &found);
        for (int lane = 0; lane < LANES && k + (uint64_t)lane < count; lane++)
            others += !is_ellipsoid(&found, lane);
    }
    free(points);
    return others;
}

/* Fits `count` instances of n points each; a row is shape, centre and level; -1 without memory. */
int hiltest_fit(const double *points, uint64_t count, uint64_t n, double *rows)
{
    lanes *some = room_for(n);
    if (some == NULL)
        return -1;
    for (uint64_t k = 0; k < count; k += LANES) {
        struct quadrics found;
        const double *from[LANES];
        for (uint64_t lane = 0; lane < LANES; lane++)
            from[lane] = points + 3 * n * (k + lane < count ? k + lane : k);
        side_by_side(from, 3 * n, some);
        fit(some, n, &found);
        for (int lane = 0; lane < LANES && k + (uint64_t)lane < count; lane++) {
            static const int entries[9] = {0, 3, 4, 3, 1, 5, 4, 5, 2};
            double *row = rows + 13 * (k + (uint64_t)lane);
            for (int j = 0; j < 9; j++)
                row[j] = found.shape[entries[j]][lane];
            for (int j = 0; j < 3; j++)
                row[9 + j] = found.centre[j][lane];
            row[12] = found.level[lane];
        }
    }
    free(some);
    return 0;
}
