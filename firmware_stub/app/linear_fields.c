#include "linear_fields.h"

#include <math.h>

bool read_finite(payload_reader_t *request, float *values, size_t count)
{
    bool is_finite = true;
    for (size_t i = 0; i < count; i++) {
        values[i] = read_f32(request);
        is_finite = is_finite && isfinite(values[i]);
    }
    return is_finite;
}

bool read_linear(payload_reader_t *request, float matrix[9], float vector[3])
{
    const bool matrix_is_finite = read_finite(request, matrix, 9);
    const bool vector_is_finite = read_finite(request, vector, 3);
    return matrix_is_finite && vector_is_finite;
}

void write_linear(payload_writer_t *reply, const float matrix[9], const float vector[3])
{
    write_f32_array(reply, matrix, 9);
    write_f32_array(reply, vector, 3);
}
