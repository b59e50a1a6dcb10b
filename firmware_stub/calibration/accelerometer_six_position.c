#include "accelerometer_fit.h"
#include "fast_code.h"

/* Cosine of the angle to a face's axis: an untrimmed part and a careless hand stay within 20 degrees, the next face is at 90. */
#define FACE_COSINE 0.94f

/* Of 1 g, what a board on a face may read: a part at another full scale is out of it, an untrimmed one is not. */
#define SMALLEST_NORM (0.6f / ACCELEROMETER_G_PER_COUNT)
#define LARGEST_NORM (1.6f / ACCELEROMETER_G_PER_COUNT)

/* Square of how askew a part's own axes are, rms of each cross-axis element: half a percent, as data sheets have it. */
#define CROSS_AXIS_SQUARED 25e-6f

/* Of meet_norms. The third pass meets faces that are askew by 1 degree to 1e-10 mg, by 20 to 4e-4; its step is below 0.1 mg where
 * there is anything to be met. */
#define PASSES 3u
#define SETTLED_COUNTS (1e-4f / ACCELEROMETER_G_PER_COUNT)

/* Opposite faces together. */
typedef struct {
    float middle[3][3]; /* of +x and -x first */
    float half[3][3];   /* half of what they differ by */
} pairs_t;

/* Which faces each thing is true of, bit f for face f. */
typedef struct {
    uint8_t given, repeated, misplaced, moved;
} faces_t;

static inline float sign_of(uint8_t face)
{
    return face % 2u == 0u ? 1.0f : -1.0f;
}

static FAST_CODE bool is_on_face(const float counts[3], uint8_t face)
{
    const float norm = __builtin_sqrtf(counts[0] * counts[0] + counts[1] * counts[1] + counts[2] * counts[2]);
    return norm > SMALLEST_NORM && norm < LARGEST_NORM && sign_of(face) * counts[face / 2u] > FACE_COSINE * norm;
}

static FAST_CODE faces_t look_at(const still_poses_t *poses)
{
    faces_t faces = {0};
    for (uint8_t i = 0; i < poses->count; i++) {
        const still_pose_t *pose = &poses->poses[i];
        if (pose->face >= FACE_COUNT) {
            continue;
        }
        const uint8_t bit = (uint8_t)(1u << pose->face);
        faces.repeated |= faces.given & bit;
        faces.given |= bit;
        faces.misplaced |= is_on_face(pose->accelerometer, pose->face) ? 0u : bit;
        faces.moved |= accelerometer_moved(pose) ? bit : 0u;
    }
    return faces;
}

/* Index of the first pose of these faces. */
static FAST_CODE uint8_t first_of(const still_poses_t *poses, uint8_t faces)
{
    for (uint8_t i = 0; i < poses->count; i++) {
        if (poses->poses[i].face < FACE_COUNT && ((uint32_t)faces >> poses->poses[i].face & 1u) != 0u) {
            return i;
        }
    }
    return NO_POSE;
}

static FAST_CODE bool refuse(const still_poses_t *poses, accelerometer_fit_t *fit)
{
    const uint8_t all = (uint8_t)((1u << FACE_COUNT) - 1u);
    const faces_t faces = look_at(poses);
    const uint8_t missing = (uint8_t)(all & ~faces.given);
    const uint8_t wrong = missing ? missing : faces.repeated ? faces.repeated : faces.misplaced ? faces.misplaced : faces.moved;
    if (wrong == 0u) {
        return false;
    }
    const accelerometer_status_t status = missing           ? ACCELEROMETER_MISSING_FACE
                                          : faces.repeated  ? ACCELEROMETER_REPEATED_FACE
                                          : faces.misplaced ? ACCELEROMETER_MISPLACED_FACE
                                                            : ACCELEROMETER_MOVED;
    accelerometer_no_fit(status, wrong, first_of(poses, wrong), fit);
    return true;
}

/* By its adjugate. Each row is ruled by its own axis, unless six readings contradict each other; then it may not be finite. */
static FAST_CODE void invert(float m[3][3], float inverse[3][3])
{
    const float xx = m[1][1] * m[2][2] - m[1][2] * m[2][1];
    const float yx = m[1][2] * m[2][0] - m[1][0] * m[2][2];
    const float zx = m[1][0] * m[2][1] - m[1][1] * m[2][0];
    const float scale = 1.0f / (m[0][0] * xx + m[0][1] * yx + m[0][2] * zx);
    inverse[0][0] = scale * xx;
    inverse[1][0] = scale * yx;
    inverse[2][0] = scale * zx;
    inverse[0][1] = scale * (m[0][2] * m[2][1] - m[0][1] * m[2][2]);
    inverse[1][1] = scale * (m[0][0] * m[2][2] - m[0][2] * m[2][0]);
    inverse[2][1] = scale * (m[0][1] * m[2][0] - m[0][0] * m[2][1]);
    inverse[0][2] = scale * (m[0][1] * m[1][2] - m[0][2] * m[1][1]);
    inverse[1][2] = scale * (m[0][2] * m[1][0] - m[0][0] * m[1][2]);
    inverse[2][2] = scale * (m[0][0] * m[1][1] - m[0][1] * m[1][0]);
}

static FAST_CODE void apply(float m[3][3], const float v[3], float product[3])
{
    for (uint32_t row = 0; row < 3u; row++) {
        product[row] = m[row][0] * v[0] + m[row][1] * v[1] + m[row][2] * v[2];
    }
}

static FAST_CODE void pair_faces(const still_poses_t *poses, pairs_t *pairs)
{
    float counts[FACE_COUNT][3];
    for (uint8_t i = 0; i < poses->count; i++) {
        const uint8_t face = poses->poses[i].face;
        for (uint32_t axis = 0; axis < 3u && face < FACE_COUNT; axis++) {
            counts[face][axis] = poses->poses[i].accelerometer[axis];
        }
    }
    for (uint32_t pair = 0; pair < 3u; pair++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            pairs->middle[pair][axis] = 0.5f * (counts[2u * pair][axis] + counts[2u * pair + 1u][axis]);
            pairs->half[pair][axis] = 0.5f * (counts[2u * pair][axis] - counts[2u * pair + 1u][axis]);
        }
    }
}

/* Squares of the gains that meet the mean norm of each pair, for some offsets. */
static FAST_CODE void fit_squares(const pairs_t *pairs, const float offset[3], float squares[3])
{
    float rows[3][3];
    float inverse[3][3];
    for (uint32_t pair = 0; pair < 3u; pair++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            const float from_offset = pairs->middle[pair][axis] - offset[axis];
            rows[pair][axis] = from_offset * from_offset + pairs->half[pair][axis] * pairs->half[pair][axis];
        }
    }
    invert(rows, inverse);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        squares[axis] = inverse[axis][0] + inverse[axis][1] + inverse[axis][2];
    }
}

/* How far offsets are from those with which opposite faces have the same norm, for some gains. */
static FAST_CODE void fit_step(const pairs_t *pairs, const float offset[3], const float squares[3], float step[3])
{
    float rows[3][3];
    float inverse[3][3];
    float differences[3];
    for (uint32_t pair = 0; pair < 3u; pair++) {
        float difference = 0.0f;
        for (uint32_t axis = 0; axis < 3u; axis++) {
            rows[pair][axis] = squares[axis] * pairs->half[pair][axis];
            difference += rows[pair][axis] * (pairs->middle[pair][axis] - offset[axis]);
        }
        differences[pair] = difference;
    }
    invert(rows, inverse);
    apply(inverse, differences, step);
}

/* Offsets and gains that make gravity 1 g long on every face: of the two equations of a pair the mean is linear in the squares of the
 * gains, the difference in the offsets, and each hardly feels the other. False where there are none. */
static FAST_CODE bool meet_norms(const pairs_t *pairs, float offset[3], float gains[3])
{
    float squares[3];
    float step[3];
    bool is_met = true;
    for (uint32_t axis = 0; axis < 3u; axis++) {
        offset[axis] = pairs->middle[axis][axis];
    }
    for (uint32_t pass = 0; pass < PASSES; pass++) {
        fit_squares(pairs, offset, squares);
        fit_step(pairs, offset, squares, step);
        for (uint32_t axis = 0; axis < 3u; axis++) {
            offset[axis] += step[axis];
        }
    }
    fit_squares(pairs, offset, squares);
    for (uint32_t axis = 0; axis < 3u; axis++) {
        /* No NaN passes either. */
        is_met = is_met && step[axis] <= SETTLED_COUNTS && step[axis] >= -SETTLED_COUNTS && squares[axis] > 0.0f;
        gains[axis] = __builtin_sqrtf(squares[axis]);
    }
    return is_met;
}

/* The part's axes, columns, of what opposite faces differ by across their own: as much of it as the middles do not tell to be the
 * faces'. Both have half of the faces' variance, and each middle is seen across two axes. */
static FAST_CODE void find_axes(const pairs_t *pairs, const float offset[3], const float gains[3], float axes[3][3])
{
    float half_variance = 0.0f;
    for (uint32_t pair = 0; pair < 3u; pair++) {
        for (uint32_t axis = 0; axis < 3u; axis++) {
            const float middle_g = axis == pair ? 0.0f : gains[axis] * (pairs->middle[pair][axis] - offset[axis]);
            half_variance += middle_g * middle_g * (1.0f / 6.0f);
        }
    }
    const float weight = CROSS_AXIS_SQUARED / (CROSS_AXIS_SQUARED + half_variance);
    for (uint32_t pair = 0; pair < 3u; pair++) {
        const float scale = weight / pairs->half[pair][pair];
        for (uint32_t axis = 0; axis < 3u; axis++) {
            axes[axis][pair] = axis == pair ? 1.0f : scale * pairs->half[pair][axis];
        }
    }
}

FAST_CODE void accelerometer_six_position(const still_poses_t *poses, accelerometer_fit_t *fit)
{
    pairs_t pairs;
    pairs_t straightened;
    float offset[3];
    float gains[3];
    float axes[3][3];
    float straight[3][3];

    if (refuse(poses, fit)) {
        return;
    }
    pair_faces(poses, &pairs);
    if (!meet_norms(&pairs, offset, gains)) {
        accelerometer_no_fit(ACCELEROMETER_NOT_AN_ELLIPSOID, 0, NO_POSE, fit);
        return;
    }
    find_axes(&pairs, offset, gains, axes);
    invert(axes, straight);
    for (uint32_t pair = 0; pair < 3u; pair++) {
        apply(straight, pairs.middle[pair], straightened.middle[pair]);
        apply(straight, pairs.half[pair], straightened.half[pair]);
    }
    if (!meet_norms(&straightened, offset, gains)) {
        accelerometer_no_fit(ACCELEROMETER_NOT_AN_ELLIPSOID, 0, NO_POSE, fit);
        return;
    }
    fit->status = ACCELEROMETER_OK;
    fit->faces = 0;
    fit->pose = NO_POSE;
    apply(axes, offset, fit->calibration.offset);
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            fit->calibration.gain[3u * row + column] = gains[row] * straight[row][column];
        }
    }
}
