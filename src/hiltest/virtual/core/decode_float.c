/* Encodings of coprocessors: the FPU (DDI 0403E, A6.4 to A6.8), which is coprocessors 10 and 11, and those that are
 * missing (A5.3.18).
 */

#include "decode.h"

#include <stddef.h>

/* An s register: four bits, and a lowest bit that stands alone. */
static uint8_t single_at(const struct code_word *word, unsigned low, unsigned lowest)
{
    return (uint8_t)(bits(word->bits, low + 3, low) << 1 | bits(word->bits, lowest, lowest));
}

/* A d register: four bits; the lone bit would be its highest one, but FPv4-SP has d0 to d15. Returns the lower one of
 * its s registers. */
static uint8_t double_at(const struct code_word *word, struct instruction *decoded, unsigned low, unsigned highest)
{
    if (is_set(word->bits, highest)) undefine(decoded);
    return (uint8_t)(bits(word->bits, low + 3, low) << 1);
}

static bool is_double(const struct code_word *word) { return is_set(word->bits, 8); }

static void take_d(const struct code_word *word, struct instruction *decoded) { decoded->d = single_at(word, 12, 22); }

static void two_registers(const struct code_word *word, struct instruction *decoded)
{
    take_d(word, decoded);
    decoded->m = single_at(word, 0, 5);
}

static void three_registers(const struct code_word *word, struct instruction *decoded)
{
    two_registers(word, decoded);
    decoded->n = single_at(word, 16, 7);
}

/* VFPExpandImm, A6.4 */
static void number(const struct code_word *word, struct instruction *decoded)
{
    uint32_t code = bits(word->bits, 19, 16) << 4 | bits(word->bits, 3, 0);
    uint32_t exponent = is_set(code, 6) ? 0x7C : 0x80;
    take_d(word, decoded);
    decoded->immediate = bits(code, 7, 7) << 31 | (exponent | bits(code, 5, 4)) << 23 | bits(code, 3, 0) << 19;
}

static void compare(const struct code_word *word, struct instruction *decoded)
{
    two_registers(word, decoded);
    decoded->amount = (uint8_t)bits(word->bits, 7, 7);
}

static void compare_zero(const struct code_word *word, struct instruction *decoded)
{
    take_d(word, decoded);
    decoded->amount = (uint8_t)bits(word->bits, 7, 7);
}

static void half_precision(const struct code_word *word, struct instruction *decoded)
{
    two_registers(word, decoded);
    decoded->amount = (uint8_t)bits(word->bits, 7, 7);
}

static void to_integer(const struct code_word *word, struct instruction *decoded)
{
    bool is_signed = is_set(word->bits, 16), truncates = is_set(word->bits, 7);
    two_registers(word, decoded);
    decoded->amount = (uint8_t)(is_signed | !truncates << 1);
}

static void from_integer(const struct code_word *word, struct instruction *decoded)
{
    two_registers(word, decoded);
    decoded->amount = (uint8_t)bits(word->bits, 7, 7);
}

/* More fraction bits than bits are UNPREDICTABLE (A7.7, VCVT). */
static void fixed_point(const struct code_word *word, struct instruction *decoded)
{
    bool is_signed = !is_set(word->bits, 16), is_long = is_set(word->bits, 7);
    uint32_t width = is_long ? 32 : 16, integer_bits = single_at(word, 0, 5);
    take_d(word, decoded);
    decoded->amount = (uint8_t)(is_signed | is_long << 1);
    decoded->immediate = width - integer_bits;
    if (integer_bits > width) undefine(decoded);
}

static void single_and_core(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = register_at(word, 12);
    decoded->n = single_at(word, 16, 7);
    refuse_pc(decoded, decoded->d);
}

/* VMOV.32: half x of a d register */
static void half_and_core(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = register_at(word, 12);
    decoded->n = (uint8_t)(double_at(word, decoded, 16, 7) | bits(word->bits, 21, 21));
    refuse_pc(decoded, decoded->d);
}

static void status_to_core(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = register_at(word, 12);
}

static void status_from_core(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = register_at(word, 12);
    refuse_pc(decoded, decoded->d);
}

/* Two s registers, the second of which would be s32 behind s31: UNPREDICTABLE (A7.7, VMOV). */
static void pair_and_core(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = register_at(word, 12);
    decoded->a = register_at(word, 16);
    decoded->m = is_double(word) ? double_at(word, decoded, 0, 5) : single_at(word, 0, 5);
    refuse_pc(decoded, decoded->d);
    refuse_pc(decoded, decoded->a);
    if (decoded->m == 31) undefine(decoded);
}

static void access_single(const struct code_word *word, struct instruction *decoded)
{
    uint32_t offset = 4 * bits(word->bits, 7, 0);
    decoded->d = is_double(word) ? double_at(word, decoded, 12, 22) : single_at(word, 12, 22);
    decoded->n = register_at(word, 16);
    decoded->immediate = is_set(word->bits, 23) ? offset : 0 - offset;
    decoded->words = is_double(word) ? 2 : 1;
}

static void store_single(const struct code_word *word, struct instruction *decoded)
{
    access_single(word, decoded);
    refuse_pc(decoded, decoded->n);
}

static void load_single(const struct code_word *word, struct instruction *decoded)
{
    access_single(word, decoded);
    if (decoded->n == PC) decoded->immediate += literal_base(word);
}

/* Registers past s31, and none, are UNPREDICTABLE (A7.7, VLDM); Unicorn takes them as undefined. An odd count of words
 * with d registers is FLDMX or FSTMX: the last word is not transferred, but the base moves by it, so `immediate` is the
 * distance that the base moves. */
static void multiple(const struct code_word *word, struct instruction *decoded)
{
    uint32_t count = bits(word->bits, 7, 0), transferred = is_double(word) ? count & ~1u : count;
    bool upward = is_set(word->bits, 23), writes_base = is_set(word->bits, 21);
    decoded->d = is_double(word) ? double_at(word, decoded, 12, 22) : single_at(word, 12, 22);
    decoded->n = register_at(word, 16);
    decoded->words = (uint8_t)transferred;
    decoded->immediate = 4 * count;
    decoded->mode = (uint8_t)((upward ? 0 : MODE_BEFORE) | (writes_base ? MODE_WRITES_BACK : 0));
    refuse_pc(decoded, decoded->n);
    if (transferred == 0 || decoded->d + transferred > 32) undefine(decoded);
}

/* A6.5 to A6.8. Bit 8 says whether registers are d registers, of which only moves are left (FPv4-SP). */
static const struct encoding FLOAT[] = {
    {"VMLA T1", 0xFFB00F50, 0xEE000A00, OP_VMLA, three_registers, ARMV7M, 0},
    {"VMLS T1", 0xFFB00F50, 0xEE000A40, OP_VMLS, three_registers, ARMV7M, 0},
    {"VNMLS T1", 0xFFB00F50, 0xEE100A00, OP_VNMLS, three_registers, ARMV7M, 0},
    {"VNMLA T1", 0xFFB00F50, 0xEE100A40, OP_VNMLA, three_registers, ARMV7M, 0},
    {"VMUL T1", 0xFFB00F50, 0xEE200A00, OP_VMUL, three_registers, ARMV7M, 0},
    {"VNMUL T1", 0xFFB00F50, 0xEE200A40, OP_VNMUL, three_registers, ARMV7M, 0},
    {"VADD T1", 0xFFB00F50, 0xEE300A00, OP_VADD, three_registers, ARMV7M, 0},
    {"VSUB T1", 0xFFB00F50, 0xEE300A40, OP_VSUB, three_registers, ARMV7M, 0},
    {"VDIV T1", 0xFFB00F50, 0xEE800A00, OP_VDIV, three_registers, ARMV7M, 0},
    {"VFNMS T1", 0xFFB00F50, 0xEE900A00, OP_VFNMS, three_registers, ARMV7M, 0},
    {"VFNMA T1", 0xFFB00F50, 0xEE900A40, OP_VFNMA, three_registers, ARMV7M, 0},
    {"VFMA T1", 0xFFB00F50, 0xEEA00A00, OP_VFMA, three_registers, ARMV7M, 0},
    {"VFMS T1", 0xFFB00F50, 0xEEA00A40, OP_VFMS, three_registers, ARMV7M, 0},
    {"VMOV (immediate) T1", 0xFFB00FF0, 0xEEB00A00, OP_VMOV_I, number, ARMV7M, 0},
    {"VMOV (register) T1", 0xFFBF0FD0, 0xEEB00A40, OP_VMOV, two_registers, ARMV7M, 0},
    {"VABS T1", 0xFFBF0FD0, 0xEEB00AC0, OP_VABS, two_registers, ARMV7M, 0},
    {"VNEG T1", 0xFFBF0FD0, 0xEEB10A40, OP_VNEG, two_registers, ARMV7M, 0},
    {"VSQRT T1", 0xFFBF0FD0, 0xEEB10AC0, OP_VSQRT, two_registers, ARMV7M, 0},
    {"VCVTB, VCVTT T1, from half", 0xFFBF0F50, 0xEEB20A40, OP_VCVT_FROM_HALF, half_precision, ARMV7M, 0},
    {"VCVTB, VCVTT T1, to half", 0xFFBF0F50, 0xEEB30A40, OP_VCVT_TO_HALF, half_precision, ARMV7M, 0},
    {"VCMP, VCMPE T1", 0xFFBF0F50, 0xEEB40A40, OP_VCMP, compare, ARMV7M, 0},
    {"VCMP, VCMPE T2", 0xFFBF0F7F, 0xEEB50A40, OP_VCMP_ZERO, compare_zero, ARMV7M, 0},
    {"VCVT T1, from integer", 0xFFBF0F50, 0xEEB80A40, OP_VCVT_FROM_INTEGER, from_integer, ARMV7M, 0},
    {"VCVT T1, from fixed point", 0xFFBE0F50, 0xEEBA0A40, OP_VCVT_FROM_FIXED, fixed_point, ARMV7M, 0},
    {"VCVT, VCVTR T1, to integer", 0xFFBE0F50, 0xEEBC0A40, OP_VCVT_TO_INTEGER, to_integer, ARMV7M, 0},
    {"VCVT T1, to fixed point", 0xFFBE0F50, 0xEEBE0A40, OP_VCVT_TO_FIXED, fixed_point, ARMV7M, 0},
    {"VMOV T1, from core to single", 0xFFF00F7F, 0xEE000A10, OP_VMOV_FROM_CORE, single_and_core, ARMV7M, 0},
    {"VMOV T1, from single to core", 0xFFF00F7F, 0xEE100A10, OP_VMOV_TO_CORE, single_and_core, ARMV7M, 0},
    {"VMOV T1, from core to half of double", 0xFFD00F7F, 0xEE000B10, OP_VMOV_FROM_CORE, half_and_core, ARMV7M, 0},
    {"VMOV T1, from half of double to core", 0xFFD00F7F, 0xEE100B10, OP_VMOV_TO_CORE, half_and_core, ARMV7M, 0},
    {"VMSR T1", 0xFFFF0FFF, 0xEEE10A10, OP_VMSR, status_from_core, ARMV7M, 0},
    {"VMRS T1", 0xFFFF0FFF, 0xEEF10A10, OP_VMRS, status_to_core, ARMV7M, 0},
    {"VMOV T1, from core to pair", 0xFFF00ED0, 0xEC400A10, OP_VMOV_PAIR_FROM_CORE, pair_and_core, ARMV7M, 0},
    {"VMOV T1, from pair to core", 0xFFF00ED0, 0xEC500A10, OP_VMOV_PAIR_TO_CORE, pair_and_core, ARMV7M, 0},
    {"VSTR T1, T2", 0xFF300E00, 0xED000A00, OP_VSTR, store_single, ARMV7M, 0},
    {"VLDR T1, T2", 0xFF300E00, 0xED100A00, OP_VLDR, load_single, ARMV7M, 0},
    {"VSTM T1, T2, upward", 0xFF900E00, 0xEC800A00, OP_VSTM, multiple, ARMV7M, 0},
    {"VLDM T1, T2, upward", 0xFF900E00, 0xEC900A00, OP_VLDM, multiple, ARMV7M, 0},
    {"VSTMDB T1, T2", 0xFFB00E00, 0xED200A00, OP_VSTM, multiple, ARMV7M, 0},
    {"VLDMDB T1, T2", 0xFFB00E00, 0xED300A00, OP_VLDM, multiple, ARMV7M, 0},
};

/* A5.3.18. The first two rows are undefined whatever the coprocessor. */
static const struct encoding COPROCESSORS[] = {
    {"Undefined instructions of the FPU", 0xFC000E00, 0xFC000A00, OP_UNDEFINED, no_fields, ARMV7M, 0},
    {"Undefined coprocessor instructions", 0xEFE00000, 0xEC000000, OP_UNDEFINED, no_fields, ARMV7M, 0},
    {"MCRR, MCRR2 T1", 0xEFF00000, 0xEC400000, OP_NO_COPROCESSOR, no_fields, ARMV7M, 0},
    {"MRRC, MRRC2 T1", 0xEFF00000, 0xEC500000, OP_NO_COPROCESSOR, no_fields, ARMV7M, 0},
    {"STC, STC2 T1", 0xEE100000, 0xEC000000, OP_NO_COPROCESSOR, no_fields, ARMV7M, 0},
    {"LDC, LDC2 T1", 0xEE100000, 0xEC100000, OP_NO_COPROCESSOR, no_fields, ARMV7M, 0},
    {"CDP, CDP2 T1", 0xEF000010, 0xEE000000, OP_NO_COPROCESSOR, no_fields, ARMV7M, 0},
    {"MCR, MCR2 T1", 0xEF100010, 0xEE000010, OP_NO_COPROCESSOR, no_fields, ARMV7M, 0},
    {"MRC, MRC2 T1", 0xEF100010, 0xEE100010, OP_NO_COPROCESSOR, no_fields, ARMV7M, 0},
};

const struct encoding_group float_groups[] = {
    GROUP(0xFC000E00, 0xEC000A00, FLOAT),
    GROUP(0xEC000000, 0xEC000000, COPROCESSORS),
    {0, 0, NULL, 0},
};
