#include "fit_fields.h"

#define FIT_FLAG_SPHERE 0x01u

void write_fit(payload_writer_t *reply, const magnetometer_fit_t *fit, uint8_t flags)
{
    write_u8(reply, (uint8_t)fit->status);
    write_u8(reply, flags | (fit->is_sphere != 0u ? FIT_FLAG_SPHERE : 0u));
    write_u16(reply, fit->iterations);
    write_f32_array(reply, fit->soft_iron, 9);
    write_f32_array(reply, fit->hard_iron, 3);
    write_f32(reply, fit->coverage);
}
