/* Encodings of coprocessors: the FPU (DDI 0403E, A6.4 to A6.8), which is coprocessors 10 and 11, and missing
 * coprocessors (A5.3.18).
 */

#include "decode.h"

#include <stddef.h>

/* A d register: four bits; the separate bit would be its highest one, but FPv4-SP has only d0 to d15. Returns the lower
 * one of its s registers. */
static uint8_t double_at(const struct code_word *word, struct instruction *decoded, unsigned low, unsigned highest)
{
    if (is_set(word->bits, highest)) undefine(decoded);
    return (uint8_t)(bits(word->bits, low + 3, low) << 1);
}

static bool is_double(const struct code_word *word) { return is_set(word->bits, 8); }

/* VFPExpandImm, A6.4 */
static void number(const struct code_word *word, struct instruction *decoded)
{
    uint32_t code = bits(word->bits, 19, 16) << 4 | bits(word->bits, 3, 0);
    uint32_t exponent = is_set(code, 6) ? 0x7C : 0x80;
    decoded->immediate = bits(code, 7, 7) << 31 | (exponent | bits(code, 5, 4)) << 23 | bits(code, 3, 0) << 19;
}

static void to_integer(const struct code_word *word, struct instruction *decoded)
{
    bool is_signed = is_set(word->bits, 16), truncates = is_set(word->bits, 7);
    decoded->amount = (uint8_t)(is_signed | !truncates << 1);
}

/* A fraction with more bits than the number is UNPREDICTABLE (A7.7, VCVT). */
static void fixed_point(const struct code_word *word, struct instruction *decoded)
{
    bool is_signed = !is_set(word->bits, 16), is_long = is_set(word->bits, 7);
    uint32_t width = is_long ? 32 : 16, integer_bits = single_at(word, 0);
    decoded->amount = (uint8_t)(is_signed | is_long << 1);
    decoded->immediate = width - integer_bits;
    if (integer_bits > width) undefine(decoded);
}

/* VMOV.32: half x of a d register */
static void half_and_core(const struct code_word *word, struct instruction *decoded)
{
    decoded->n = (uint8_t)(double_at(word, decoded, 16, 7) | bits(word->bits, 21, 21));
}

/* Two s registers; s31 as the first one is UNPREDICTABLE (A7.7, VMOV). */
static void pair_and_core(const struct code_word *word, struct instruction *decoded)
{
    if (is_double(word)) decoded->m = double_at(word, decoded, 0, 5);
    if (decoded->m == 31) undefine(decoded);
}

static void access_single(const struct code_word *word, struct instruction *decoded)
{
    if (is_double(word)) decoded->d = double_at(word, decoded, 12, 22);
    decoded->words = is_double(word) ? 2 : 1;
    if (!is_set(word->bits, 23)) decoded->immediate = 0 - decoded->immediate;
}

static void load_single(const struct code_word *word, struct instruction *decoded)
{
    access_single(word, decoded);
    if (decoded->n == PC) decoded->immediate += literal_base(word);
}

/* Registers beyond s31, and no registers, are UNPREDICTABLE (A7.7, VLDM); they are undefined as in Unicorn. An odd
 * count of words with d registers is FLDMX or FSTMX: the last word is not transferred, but the base moves by it, so
 * `immediate` is the distance that the base moves. */
static void multiple(const struct code_word *word, struct instruction *decoded)
{
    uint32_t count = bits(word->bits, 7, 0), transferred = is_double(word) ? count & ~1u : count;
    bool upward = is_set(word->bits, 23), writes_base = is_set(word->bits, 21);
    if (is_double(word)) decoded->d = double_at(word, decoded, 12, 22);
    decoded->words = (uint8_t)transferred;
    decoded->mode = (uint8_t)((upward ? 0 : MODE_BEFORE) | (writes_base ? MODE_WRITES_BACK : 0));
    if (transferred == 0 || decoded->d + transferred > 32) undefine(decoded);
}

#define D_M SINGLE(d, 12), SINGLE(m, 0)
#define D_N_M D_M, SINGLE(n, 16)
#define PAIR NOT_PC(d, 12), NOT_PC(a, 16), SINGLE(m, 0), .extract = pair_and_core
#define HALF NOT_PC(d, 12), .extract = half_and_core
#define ACCESS SINGLE(d, 12), NUMBER(0, 8, 2)
#define MULTIPLE ACCESS, NOT_PC(n, 16), .extract = multiple

/* A6.5 to A6.8. Bit 8 selects d registers, for which FPv4-SP has only moves. */
static const struct encoding FLOAT[] = {
    {"VMLA T1", 0xFFB00F50, 0xEE000A00, OP_VMLA, D_N_M},
    {"VMLS T1", 0xFFB00F50, 0xEE000A40, OP_VMLS, D_N_M},
    {"VNMLS T1", 0xFFB00F50, 0xEE100A00, OP_VNMLS, D_N_M},
    {"VNMLA T1", 0xFFB00F50, 0xEE100A40, OP_VNMLA, D_N_M},
    {"VMUL T1", 0xFFB00F50, 0xEE200A00, OP_VMUL, D_N_M},
    {"VNMUL T1", 0xFFB00F50, 0xEE200A40, OP_VNMUL, D_N_M},
    {"VADD T1", 0xFFB00F50, 0xEE300A00, OP_VADD, D_N_M},
    {"VSUB T1", 0xFFB00F50, 0xEE300A40, OP_VSUB, D_N_M},
    {"VDIV T1", 0xFFB00F50, 0xEE800A00, OP_VDIV, D_N_M},
    {"VFNMS T1", 0xFFB00F50, 0xEE900A00, OP_VFNMS, D_N_M},
    {"VFNMA T1", 0xFFB00F50, 0xEE900A40, OP_VFNMA, D_N_M},
    {"VFMA T1", 0xFFB00F50, 0xEEA00A00, OP_VFMA, D_N_M},
    {"VFMS T1", 0xFFB00F50, 0xEEA00A40, OP_VFMS, D_N_M},
    {"VMOV (immediate) T1", 0xFFB00FF0, 0xEEB00A00, OP_VMOV_I, SINGLE(d, 12), .extract = number},
    {"VMOV (register) T1", 0xFFBF0FD0, 0xEEB00A40, OP_VMOV, D_M},
    {"VABS T1", 0xFFBF0FD0, 0xEEB00AC0, OP_VABS, D_M},
    {"VNEG T1", 0xFFBF0FD0, 0xEEB10A40, OP_VNEG, D_M},
    {"VSQRT T1", 0xFFBF0FD0, 0xEEB10AC0, OP_VSQRT, D_M},
    {"VCVTB, VCVTT T1, from half", 0xFFBF0F50, 0xEEB20A40, OP_VCVT_FROM_HALF, D_M, AMOUNT(7, 1)},
    {"VCVTB, VCVTT T1, to half", 0xFFBF0F50, 0xEEB30A40, OP_VCVT_TO_HALF, D_M, AMOUNT(7, 1)},
    {"VCMP, VCMPE T1", 0xFFBF0F50, 0xEEB40A40, OP_VCMP, D_M, AMOUNT(7, 1)},
    {"VCMP, VCMPE T2", 0xFFBF0F7F, 0xEEB50A40, OP_VCMP_ZERO, SINGLE(d, 12), AMOUNT(7, 1)},
    {"VCVT T1, from integer", 0xFFBF0F50, 0xEEB80A40, OP_VCVT_FROM_INTEGER, D_M, AMOUNT(7, 1)},
    {"VCVT T1, from fixed point", 0xFFBE0F50, 0xEEBA0A40, OP_VCVT_FROM_FIXED, SINGLE(d, 12), .extract = fixed_point},
    {"VCVT, VCVTR T1, to integer", 0xFFBE0F50, 0xEEBC0A40, OP_VCVT_TO_INTEGER, D_M, .extract = to_integer},
    {"VCVT T1, to fixed point", 0xFFBE0F50, 0xEEBE0A40, OP_VCVT_TO_FIXED, SINGLE(d, 12), .extract = fixed_point},
    {"VMOV T1, from core to single", 0xFFF00F7F, 0xEE000A10, OP_VMOV_FROM_CORE, NOT_PC(d, 12), SINGLE(n, 16)},
    {"VMOV T1, from single to core", 0xFFF00F7F, 0xEE100A10, OP_VMOV_TO_CORE, NOT_PC(d, 12), SINGLE(n, 16)},
    {"VMOV T1, from core to half of double", 0xFFD00F7F, 0xEE000B10, OP_VMOV_FROM_CORE, HALF},
    {"VMOV T1, from half of double to core", 0xFFD00F7F, 0xEE100B10, OP_VMOV_TO_CORE, HALF},
    {"VMSR T1", 0xFFFF0FFF, 0xEEE10A10, OP_VMSR, NOT_PC(d, 12)},
    {"VMRS T1", 0xFFFF0FFF, 0xEEF10A10, OP_VMRS, ANY(d, 12)},
    {"VMOV T1, from core to pair", 0xFFF00ED0, 0xEC400A10, OP_VMOV_PAIR_FROM_CORE, PAIR},
    {"VMOV T1, from pair to core", 0xFFF00ED0, 0xEC500A10, OP_VMOV_PAIR_TO_CORE, PAIR},
    {"VSTR T1, T2", 0xFF300E00, 0xED000A00, OP_VSTR, ACCESS, NOT_PC(n, 16), .extract = access_single},
    {"VLDR T1, T2", 0xFF300E00, 0xED100A00, OP_VLDR, ACCESS, ANY(n, 16), .extract = load_single},
    {"VSTM T1, T2, upward", 0xFF900E00, 0xEC800A00, OP_VSTM, MULTIPLE},
    {"VLDM T1, T2, upward", 0xFF900E00, 0xEC900A00, OP_VLDM, MULTIPLE},
    {"VSTMDB T1, T2", 0xFFB00E00, 0xED200A00, OP_VSTM, MULTIPLE},
    {"VLDMDB T1, T2", 0xFFB00E00, 0xED300A00, OP_VLDM, MULTIPLE},
};

/* A5.3.18. The first two rows are undefined for every coprocessor. */
static const struct encoding COPROCESSORS[] = {
    {"Undefined instructions of the FPU", 0xFC000E00, 0xFC000A00, OP_UNDEFINED, .extract = NULL},
    {"Undefined coprocessor instructions", 0xEFE00000, 0xEC000000, OP_UNDEFINED, .extract = NULL},
    {"MCRR, MCRR2 T1", 0xEFF00000, 0xEC400000, OP_NO_COPROCESSOR, .extract = NULL},
    {"MRRC, MRRC2 T1", 0xEFF00000, 0xEC500000, OP_NO_COPROCESSOR, .extract = NULL},
    {"STC, STC2 T1", 0xEE100000, 0xEC000000, OP_NO_COPROCESSOR, .extract = NULL},
    {"LDC, LDC2 T1", 0xEE100000, 0xEC100000, OP_NO_COPROCESSOR, .extract = NULL},
    {"CDP, CDP2 T1", 0xEF000010, 0xEE000000, OP_NO_COPROCESSOR, .extract = NULL},
    {"MCR, MCR2 T1", 0xEF100010, 0xEE000010, OP_NO_COPROCESSOR, .extract = NULL},
    {"MRC, MRC2 T1", 0xEF100010, 0xEE100010, OP_NO_COPROCESSOR, .extract = NULL},
};

const struct encoding_group float_groups[] = {
    GROUP(0xFC000E00, 0xEC000A00, FLOAT),
    GROUP(0xEC000000, 0xEC000000, COPROCESSORS),
    {0, 0, NULL, 0},
};
