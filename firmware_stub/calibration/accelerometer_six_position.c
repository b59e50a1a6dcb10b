#include "accelerometer_fit.h"
#include "fast_code.h"

/* Cosine of the angle to a face's axis: an untrimmed part and a careless hand stay within 20 degrees, the next face is at 90. With
 * it every column of the half differences below is ruled by its own axis, so the normal equations are never singular. */
#define FACE_COSINE 0.94f

/* Of 1 g, what a board on a face may read: a part at another full scale is out of it, an untrimmed one is not. */
#define SMALLEST_NORM (0.6f / ACCELEROMETER_G_PER_COUNT)
#define LARGEST_NORM (1.6f / ACCELEROMETER_G_PER_COUNT)

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

/* Inverse of a symmetric matrix, by its adjugate. */
static FAST_CODE void invert_symmetric(const float m[9], float inverse[9])
{
    const float xx = m[4] * m[8] - m[5] * m[5];
    const float xy = m[2] * m[5] - m[1] * m[8];
    const float xz = m[1] * m[5] - m[2] * m[4];
    const float scale = 1.0f / (m[0] * xx + m[1] * xy + m[2] * xz);
    inverse[0] = scale * xx;
    inverse[1] = inverse[3] = scale * xy;
    inverse[2] = inverse[6] = scale * xz;
    inverse[4] = scale * (m[0] * m[8] - m[2] * m[2]);
    inverse[5] = inverse[7] = scale * (m[1] * m[2] - m[0] * m[5]);
    inverse[8] = scale * (m[0] * m[4] - m[1] * m[1]);
}

/* Counts of the six faces about their mean, and the mean. Opposite faces are added first: what is large cancels before anything
 * is rounded away. */
static FAST_CODE void sort_faces(const still_poses_t *poses, float about_mean[FACE_COUNT][3], float mean[3])
{
    for (uint8_t i = 0; i < poses->count; i++) {
        const uint8_t face = poses->poses[i].face;
        for (uint32_t axis = 0; axis < 3u && face < FACE_COUNT; axis++) {
            about_mean[face][axis] = poses->poses[i].accelerometer[axis];
        }
    }
    for (uint32_t axis = 0; axis < 3u; axis++) {
        const float x = about_mean[0][axis] + about_mean[1][axis];
        const float y = about_mean[2][axis] + about_mean[3][axis];
        const float z = about_mean[4][axis] + about_mean[5][axis];
        mean[axis] = (x + y + z) * (1.0f / (float)FACE_COUNT);
        for (uint32_t face = 0; face < FACE_COUNT; face++) {
            about_mean[face][axis] -= mean[axis];
        }
    }
}

static FAST_CODE void sum_products(float d[FACE_COUNT][3], float normal[9])
{
    for (uint32_t row = 0; row < 3u; row++) {
        for (uint32_t column = 0; column < 3u; column++) {
            float sum = 0.0f;
            for (uint32_t face = 0; face < FACE_COUNT; face++) {
                sum += d[face][row] * d[face][column];
            }
            normal[3u * row + column] = sum;
        }
    }
}

FAST_CODE void accelerometer_six_position(const still_poses_t *poses, accelerometer_fit_t *fit)
{
    float d[FACE_COUNT][3];
    float normal[9];
    float inverse[9];

    if (refuse(poses, fit)) {
        return;
    }
    fit->status = ACCELEROMETER_OK;
    fit->faces = 0;
    fit->pose = NO_POSE;
    sort_faces(poses, d, fit->calibration.offset);
    sum_products(d, normal);
    invert_symmetric(normal, inverse);
    for (uint32_t row = 0; row < 3u; row++) {
        /* Gravity of the other faces has nothing on this axis. */
        const float x = d[2u * row][0] - d[2u * row + 1u][0];
        const float y = d[2u * row][1] - d[2u * row + 1u][1];
        const float z = d[2u * row][2] - d[2u * row + 1u][2];
        for (uint32_t column = 0; column < 3u; column++) {
            fit->calibration.gain[3u * row + column] = x * inverse[column] + y * inverse[3u + column] + z * inverse[6u + column];
        }
    }
}
