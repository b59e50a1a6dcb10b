#include "element_fits.h"

#include "fast_code.h"
#include "fit_result.h"
#include "square_root.h"
#include "ten_elements.h"

/* Coordinates are divided by what 50 uT are in counts, whatever the field is. */
#define UNIT 500.0f

#define SIXTH_POWER(x) ((x) * (x) * (x) * (x) * (x) * (x))

static FAST_CODE void place_hard_iron(const int32_t anchor[3], const float centre[3], trial_t *trial)
{
    for (int axis = 0; axis < 3; axis++) {
        trial->hard_iron[axis] = (float)anchor[axis] + centre[axis];
    }
}

FAST_CODE bool element_fit_4(const moments_t *sums, const int32_t anchor[3], trial_t *trial)
{
    const moments_t *const s = sums;
    sphere_t sphere;
    if (!sphere_from_moments(sums, &sphere)) {
        return false;
    }
    const float lowest = ELEMENT_FITS_WEAKEST * ELEMENT_FITS_WEAKEST, highest = ELEMENT_FITS_STRONGEST * ELEMENT_FITS_STRONGEST;
    if (!(sphere.square >= lowest && sphere.square <= highest)) {
        return false;
    }
    /* The part of sum |p|^4 that least squares leaves. */
    const float error = s->xxxx + s->yyyy + s->zzzz + 2.0f * (s->xxyy + s->xxzz + s->yyzz) - sphere.explained;
    trial->fit_error_percent = 50.0f * __builtin_sqrtf((error > 0.0f ? error : 0.0f) / s->one) / sphere.square;
    place_hard_iron(anchor, sphere.centre, trial);
    for (int i = 0; i < 9; i++) {
        trial->soft_iron[i] = (i % 4 == 0) ? 1.0f / __builtin_sqrtf(sphere.square) : 0.0f;
    }
    return true;
}

/* Scatter matrix of (xx, yy, zz, x, y, z, 1) in units. */
static FAST_CODE void assemble_7(const moments_t *s, jacobi_t *m)
{
    const float first = 1.0f / UNIT, second = first * first;
    const float factor[7] = {second, second, second, first, first, first, 1.0f};
    float(*const u)[JACOBI_LARGEST] = m->upper;
    u[0][1] = s->xxyy; u[0][2] = s->xxzz; u[0][3] = s->xxx; u[0][4] = s->xxy; u[0][5] = s->xxz; u[0][6] = s->xx;
    u[1][2] = s->yyzz; u[1][3] = s->xyy; u[1][4] = s->yyy; u[1][5] = s->yyz; u[1][6] = s->yy;
    u[2][3] = s->xzz; u[2][4] = s->yzz; u[2][5] = s->zzz; u[2][6] = s->zz;
    u[3][4] = s->xy; u[3][5] = s->xz; u[3][6] = s->x;
    u[4][5] = s->yz; u[4][6] = s->y;
    u[5][6] = s->z;
    m->values[0] = s->xxxx; m->values[1] = s->yyyy; m->values[2] = s->zzzz;
    m->values[3] = s->xx; m->values[4] = s->yy; m->values[5] = s->zz; m->values[6] = s->one;
    for (int i = 0; i < 7; i++) {
        m->values[i] *= factor[i] * factor[i];
        for (int j = i + 1; j < 7; j++) {
            u[i][j] *= factor[i] * factor[j];
        }
    }
}

FAST_CODE void element_fit_matrix(const moments_t *sums, uint8_t elements, jacobi_t *matrix)
{
    if (elements == TEN_ELEMENTS) {
        ten_elements_matrix(sums, UNIT, matrix);
    } else {
        assemble_7(sums, matrix);
    }
}

/* The quadric of an eigenvector, which for 7 elements has no cross terms. */
static FAST_CODE bool quadric_of(const float v[], uint8_t elements, quadric_t *quadric)
{
    if (elements == TEN_ELEMENTS) {
        return quadric_from_vector(v, UNIT, quadric);
    }
    const float along_axes[TEN_ELEMENTS] = {v[0], 0.0f, 0.0f, v[1], 0.0f, v[2], v[3], v[4], v[5], v[6]};
    return quadric_from_vector(along_axes, UNIT, quadric);
}

FAST_CODE bool element_fit_from_matrix(const jacobi_t *matrix, uint8_t elements, float count, const int32_t anchor[3], trial_t *trial)
{
    int index;
    quadric_t quadric;
    ellipsoid_t ellipsoid;
    if (!smallest_eigenvalue(matrix, elements, &index)) {
        return false;
    }
    const float *const v = matrix->vectors[index];
    if (!quadric_of(v, elements, &quadric) || !quadric_ellipsoid(&quadric, &ellipsoid)) {
        return false;
    }
    /* The field is the radius of the sphere of equal volume: of unit trace, its sixth power is level^3 / determinant. */
    const float level = ellipsoid.level;
    const float sixth = level * level * level / ellipsoid.determinant;
    if (!(sixth >= SIXTH_POWER(ELEMENT_FITS_WEAKEST) && sixth <= SIXTH_POWER(ELEMENT_FITS_STRONGEST))) {
        return false;
    }
    /* In the units and the scale of the eigenvector. */
    const float trace = elements == TEN_ELEMENTS ? v[0] + v[3] + v[5] : v[0] + v[1] + v[2];
    const float square = level / (UNIT * UNIT) * __builtin_fabsf(trace);
    trial->fit_error_percent = 50.0f * __builtin_sqrtf(__builtin_fabsf(matrix->values[index]) / count) / square;
    place_hard_iron(anchor, ellipsoid.centre, trial);
    symmetric_square_root(&quadric.shape, ellipsoid.minors, ellipsoid.determinant, 1.0f / __builtin_sqrtf(level), trial->soft_iron);
    return true;
}
