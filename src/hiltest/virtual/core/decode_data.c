/* Encodings of four bytes that access no memory: data processing, multiplication, branches, control (DDI 0403E, A5.3).
 */

#include "decode.h"

#include <stddef.h>

enum { D = 8, N = 16, M = 0, A = 12 }; /* where the registers usually stand */

/* A modified immediate constant (ThumbExpandImm_C, A5.3.2). Patterns of a zero byte are UNPREDICTABLE and zero here. */
static void expand_number(const struct code_word *word, struct instruction *decoded)
{
    uint32_t code = bits(word->bits, 26, 26) << 11 | bits(word->bits, 14, 12) << 8 | bits(word->bits, 7, 0);
    uint32_t byte = bits(code, 7, 0), rotation = bits(code, 11, 7), value = bits(code, 6, 0) | 1u << 7;
    static const uint32_t PATTERNS[] = {0x00000001, 0x00010001, 0x01000100, 0x01010101};

    if (bits(code, 11, 10) == 0) {
        decoded->immediate = byte * PATTERNS[bits(code, 9, 8)];
    } else {
        decoded->immediate = value >> rotation | value << (32 - rotation); /* the rotation is 8 to 31 */
        decoded->carry = (uint8_t)(decoded->immediate >> 31);
    }
}

/* i:imm3:imm8 */
static uint32_t plain_number(const struct code_word *word)
{
    return bits(word->bits, 26, 26) << 11 | bits(word->bits, 14, 12) << 8 | bits(word->bits, 7, 0);
}

/* imm3:imm2 */
static uint32_t split_number(const struct code_word *word)
{
    return bits(word->bits, 14, 12) << 2 | bits(word->bits, 7, 6);
}

static void take_flag_bit(const struct code_word *word, struct instruction *decoded)
{
    if (is_set(word->bits, 20)) decoded->operation += FORM_SETS_FLAGS;
}

static void take_d(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = register_at(word, D);
    refuse_pc(decoded, decoded->d);
}

static void take_n(const struct code_word *word, struct instruction *decoded)
{
    decoded->n = register_at(word, N);
    refuse_pc(decoded, decoded->n);
}

static void take_m(const struct code_word *word, struct instruction *decoded)
{
    decoded->m = register_at(word, M);
    refuse_pc(decoded, decoded->m);
}

/* Data processing with a modified immediate (A5.3.1) */

static void modified(const struct code_word *word, struct instruction *decoded)
{
    expand_number(word, decoded);
    take_flag_bit(word, decoded);
    take_d(word, decoded);
    take_n(word, decoded);
}

static void modified_move(const struct code_word *word, struct instruction *decoded)
{
    expand_number(word, decoded);
    take_flag_bit(word, decoded);
    take_d(word, decoded);
}

static void modified_compare(const struct code_word *word, struct instruction *decoded)
{
    expand_number(word, decoded);
    take_n(word, decoded);
}

/* Data processing with a plain immediate (A5.3.3) */

static void plain(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = plain_number(word);
    take_d(word, decoded);
    take_n(word, decoded);
}

static void address_above(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = literal_base(word) + plain_number(word);
    take_d(word, decoded);
}

static void address_below(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = literal_base(word) - plain_number(word);
    take_d(word, decoded);
}

static void move_half(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = bits(word->bits, 19, 16) << 12 | plain_number(word);
    take_d(word, decoded);
}

static void saturate(const struct code_word *word, struct instruction *decoded, uint32_t width)
{
    take_d(word, decoded);
    take_n(word, decoded);
    decoded->immediate = width;
    decoded->shift = is_set(word->bits, 21) ? SHIFT_ASR : SHIFT_LSL;
    decoded->amount = (uint8_t)split_number(word);
    if (decoded->shift == SHIFT_ASR && decoded->amount == 0) undefine(decoded); /* SSAT16, USAT16 out of shape */
}

static void saturate_signed(const struct code_word *word, struct instruction *decoded)
{
    saturate(word, decoded, bits(word->bits, 4, 0) + 1);
}

static void saturate_unsigned(const struct code_word *word, struct instruction *decoded)
{
    saturate(word, decoded, bits(word->bits, 4, 0));
}

/* SSAT16 and USAT16 stand where SSAT and USAT with ASR by 0 would be. */
static void saturate_halves_signed(const struct code_word *word, struct instruction *decoded)
{
    take_d(word, decoded);
    take_n(word, decoded);
    decoded->immediate = bits(word->bits, 3, 0) + 1;
}

static void saturate_halves_unsigned(const struct code_word *word, struct instruction *decoded)
{
    take_d(word, decoded);
    take_n(word, decoded);
    decoded->immediate = bits(word->bits, 3, 0);
}

/* A field that ends above bit 31 is UNPREDICTABLE (A7.7, SBFX and UBFX); Unicorn takes it as undefined. */
static void extract_bits(const struct code_word *word, struct instruction *decoded)
{
    uint32_t lowest = split_number(word), width = bits(word->bits, 4, 0) + 1;
    take_d(word, decoded);
    take_n(word, decoded);
    decoded->amount = (uint8_t)lowest;
    decoded->immediate = width;
    if (lowest + width > 32) undefine(decoded);
}

/* A field that ends below its beginning is UNPREDICTABLE (A7.7, BFC and BFI); Unicorn takes it as undefined. */
static void clear_bits(const struct code_word *word, struct instruction *decoded)
{
    uint32_t lowest = split_number(word), highest = bits(word->bits, 4, 0);
    take_d(word, decoded);
    decoded->amount = (uint8_t)lowest;
    if (highest < lowest) {
        undefine(decoded);
    } else {
        decoded->immediate = 0xFFFFFFFFu >> (31 - (highest - lowest)) << lowest;
    }
}

static void insert_bits(const struct code_word *word, struct instruction *decoded)
{
    clear_bits(word, decoded);
    take_n(word, decoded);
}

/* Data processing with a shifted register (A5.3.11). The rows name the form of a register that is not shifted. */

static void take_shifted_m(const struct code_word *word, struct instruction *decoded)
{
    uint32_t type = bits(word->bits, 5, 4), amount = split_number(word);
    set_shift(decoded, type, amount);
    if (type != SHIFT_LSL || amount != 0) decoded->operation += FORM_SHIFTED - FORM_REGISTER;
    take_m(word, decoded);
}

static void shifted(const struct code_word *word, struct instruction *decoded)
{
    take_flag_bit(word, decoded);
    take_shifted_m(word, decoded);
    take_d(word, decoded);
    take_n(word, decoded);
}

static void shifted_move(const struct code_word *word, struct instruction *decoded)
{
    take_flag_bit(word, decoded);
    take_shifted_m(word, decoded);
    take_d(word, decoded);
}

static void shifted_compare(const struct code_word *word, struct instruction *decoded)
{
    take_shifted_m(word, decoded);
    take_n(word, decoded);
}

/* PKHBT shifts to the left, PKHTB arithmetically to the right. */
static void pack(const struct code_word *word, struct instruction *decoded)
{
    take_d(word, decoded);
    take_n(word, decoded);
    take_m(word, decoded);
    set_shift(decoded, bits(word->bits, 5, 4), split_number(word));
}

/* Data processing of registers (A5.3.12 to A5.3.15) */

static void three_registers(const struct code_word *word, struct instruction *decoded)
{
    take_d(word, decoded);
    take_n(word, decoded);
    take_m(word, decoded);
}

/* CLZ, RBIT, REV: m stands twice in them; the lower one counts, as in Unicorn. */
static void two_registers(const struct code_word *word, struct instruction *decoded)
{
    take_d(word, decoded);
    take_m(word, decoded);
}

static void shift_by_register(const struct code_word *word, struct instruction *decoded)
{
    three_registers(word, decoded);
    decoded->shift = (uint8_t)bits(word->bits, 22, 21);
    decoded->sets_flags = is_set(word->bits, 20);
}

/* n = 15 adds nothing: SXTB and the like. */
static void extend_and_add(const struct code_word *word, struct instruction *decoded)
{
    two_registers(word, decoded);
    decoded->n = register_at(word, N);
    decoded->amount = (uint8_t)(8 * bits(word->bits, 5, 4));
}

/* Multiplications (A5.3.16, A5.3.17). a = 15 adds nothing where the operation says so. */

static void multiply_and_add(const struct code_word *word, struct instruction *decoded)
{
    three_registers(word, decoded);
    decoded->a = register_at(word, A);
}

static void multiply_and_must_add(const struct code_word *word, struct instruction *decoded)
{
    multiply_and_add(word, decoded);
    refuse_pc(decoded, decoded->a);
}

static void multiply_halves(const struct code_word *word, struct instruction *decoded)
{
    multiply_and_add(word, decoded);
    decoded->amount = (uint8_t)bits(word->bits, 5, 4);
}

static void multiply_option(const struct code_word *word, struct instruction *decoded)
{
    multiply_and_add(word, decoded);
    decoded->amount = (uint8_t)bits(word->bits, 4, 4);
}

static void multiply_option_and_must_add(const struct code_word *word, struct instruction *decoded)
{
    multiply_option(word, decoded);
    refuse_pc(decoded, decoded->a);
}

/* d is the lower word, a the upper one. The same register twice is UNPREDICTABLE: the upper word is written last, as in
 * Unicorn. */
static void multiply_long(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = register_at(word, 12);
    decoded->a = register_at(word, 8);
    take_n(word, decoded);
    take_m(word, decoded);
    refuse_pc(decoded, decoded->d);
    refuse_pc(decoded, decoded->a);
}

static void multiply_long_halves(const struct code_word *word, struct instruction *decoded)
{
    multiply_long(word, decoded);
    decoded->amount = (uint8_t)bits(word->bits, 5, 4);
}

static void multiply_long_option(const struct code_word *word, struct instruction *decoded)
{
    multiply_long(word, decoded);
    decoded->amount = (uint8_t)bits(word->bits, 4, 4);
}

/* Branches and control (A5.3.4) */

/* A conditional branch in an IT block is UNPREDICTABLE; Unicorn takes it as undefined. */
static void branch_if(const struct code_word *word, struct instruction *decoded)
{
    uint32_t offset = bits(word->bits, 26, 26) << 20 | bits(word->bits, 11, 11) << 19 | bits(word->bits, 13, 13) << 18
                      | bits(word->bits, 21, 16) << 12 | bits(word->bits, 10, 0) << 1;
    decoded->condition = (uint8_t)bits(word->bits, 25, 22);
    decoded->immediate = pc_operand(word) + (uint32_t)sign_extend(offset, 21);
    if (word->in_it_block) undefine(decoded);
}

static void branch(const struct code_word *word, struct instruction *decoded)
{
    uint32_t sign = bits(word->bits, 26, 26);
    uint32_t i1 = bits(word->bits, 13, 13) ^ sign ^ 1, i2 = bits(word->bits, 11, 11) ^ sign ^ 1;
    uint32_t offset = sign << 24 | i1 << 23 | i2 << 22 | bits(word->bits, 25, 16) << 12 | bits(word->bits, 10, 0) << 1;
    decoded->immediate = pc_operand(word) + (uint32_t)sign_extend(offset, 25);
}

static void hint(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    decoded->row = ROW_system;
}

static void from_special(const struct code_word *word, struct instruction *decoded)
{
    take_d(word, decoded);
    decoded->immediate = bits(word->bits, 7, 0);
}

static void to_special(const struct code_word *word, struct instruction *decoded)
{
    take_n(word, decoded);
    decoded->immediate = bits(word->bits, 7, 0);
    decoded->amount = (uint8_t)bits(word->bits, 11, 10);
}

/* A5.3.1. The comparisons are forms with d = 15 that set flags, the moves forms with n = 15. */
static const struct encoding MODIFIED[] = {
    {"TST (immediate) T1", 0xFBF08F00, 0xF0100F00, OP_TST_IS, modified_compare, ARMV7M, 0},
    {"AND (immediate) T1", 0xFBE08000, 0xF0000000, OP_AND_I, modified, ARMV7M, 0},
    {"BIC (immediate) T1", 0xFBE08000, 0xF0200000, OP_BIC_I, modified, ARMV7M, 0},
    {"MOV (immediate) T2", 0xFBEF8000, 0xF04F0000, OP_MOV_I, modified_move, ARMV7M, 0},
    {"ORR (immediate) T1", 0xFBE08000, 0xF0400000, OP_ORR_I, modified, ARMV7M, 0},
    {"MVN (immediate) T1", 0xFBEF8000, 0xF06F0000, OP_MVN_I, modified_move, ARMV7M, 0},
    {"ORN (immediate) T1", 0xFBE08000, 0xF0600000, OP_ORN_I, modified, ARMV7M, 0},
    {"TEQ (immediate) T1", 0xFBF08F00, 0xF0900F00, OP_TEQ_IS, modified_compare, ARMV7M, 0},
    {"EOR (immediate) T1", 0xFBE08000, 0xF0800000, OP_EOR_I, modified, ARMV7M, 0},
    {"CMN (immediate) T1", 0xFBF08F00, 0xF1100F00, OP_CMN_IS, modified_compare, ARMV7M, 0},
    {"ADD (immediate) T3", 0xFBE08000, 0xF1000000, OP_ADD_I, modified, ARMV7M, 0},
    {"ADC (immediate) T1", 0xFBE08000, 0xF1400000, OP_ADC_I, modified, ARMV7M, 0},
    {"SBC (immediate) T1", 0xFBE08000, 0xF1600000, OP_SBC_I, modified, ARMV7M, 0},
    {"CMP (immediate) T2", 0xFBF08F00, 0xF1B00F00, OP_CMP_IS, modified_compare, ARMV7M, 0},
    {"SUB (immediate) T3", 0xFBE08000, 0xF1A00000, OP_SUB_I, modified, ARMV7M, 0},
    {"RSB (immediate) T2", 0xFBE08000, 0xF1C00000, OP_RSB_I, modified, ARMV7M, 0},
};

/* A5.3.3 */
static const struct encoding PLAIN[] = {
    {"ADR T3", 0xFBFF8000, 0xF20F0000, OP_MOV_I, address_above, ARMV7M, 0},
    {"ADD (immediate) T4", 0xFBF08000, 0xF2000000, OP_ADD_I, plain, ARMV7M, 0},
    {"MOV (immediate) T3", 0xFBF08000, 0xF2400000, OP_MOV_I, move_half, ARMV7M, 0},
    {"ADR T2", 0xFBFF8000, 0xF2AF0000, OP_MOV_I, address_below, ARMV7M, 0},
    {"SUB (immediate) T4", 0xFBF08000, 0xF2A00000, OP_SUB_I, plain, ARMV7M, 0},
    {"MOVT T1", 0xFBF08000, 0xF2C00000, OP_MOVT, move_half, ARMV7M, 0},
    {"SSAT16 T1", 0xFFF0F0F0, 0xF3200000, OP_SSAT16, saturate_halves_signed, ARMV7M, 0},
    {"SSAT T1", 0xFFD08020, 0xF3000000, OP_SSAT, saturate_signed, ARMV7M, 0},
    {"SBFX T1", 0xFFF08020, 0xF3400000, OP_SBFX, extract_bits, ARMV7M, 0},
    {"BFC T1", 0xFFFF8020, 0xF36F0000, OP_BFC, clear_bits, ARMV7M, 0},
    {"BFI T1", 0xFFF08020, 0xF3600000, OP_BFI, insert_bits, ARMV7M, 0},
    {"USAT16 T1", 0xFFF0F0F0, 0xF3A00000, OP_USAT16, saturate_halves_unsigned, ARMV7M, 0},
    {"USAT T1", 0xFFD08020, 0xF3800000, OP_USAT, saturate_unsigned, ARMV7M, 0},
    {"UBFX T1", 0xFFF08020, 0xF3C00000, OP_UBFX, extract_bits, ARMV7M, 0},
};

/* A5.3.4. MSR, hints and the like stand where a branch would have condition 14 or 15. */
static const struct encoding CONTROL[] = {
    {"BL T1", 0xF800D000, 0xF000D000, OP_BL, branch, ARMV6M, 0},
    {"B T4", 0xF800D000, 0xF0009000, OP_B, branch, ARMV7M, 0},
    {"MSR (register) T1", 0xFFF0F300, 0xF3808000, OP_MSR, to_special, ARMV6M, 0},
    {"YIELD T2", 0xFFFFFFFF, 0xF3AF8001, OP_YIELD, hint, ARMV7M, 0},
    {"WFE T2", 0xFFFFFFFF, 0xF3AF8002, OP_WFE, hint, ARMV7M, 0},
    {"WFI T2", 0xFFFFFFFF, 0xF3AF8003, OP_WFI, hint, ARMV7M, 0},
    {"SEV T2", 0xFFFFFFFF, 0xF3AF8004, OP_SEV, hint, ARMV7M, 0},
    {"DBG T1", 0xFFFFFFF0, 0xF3AF80F0, OP_NOP, no_fields, ARMV7M, 0},
    {"NOP T2, hints", 0xFFFFFF00, 0xF3AF8000, OP_NOP, hint, ARMV7M, 0},
    {"CLREX T1", 0xFFFFFFFF, 0xF3BF8F2F, OP_CLREX, no_fields, ARMV7M, 0},
    {"DSB T1", 0xFFFFFFF0, 0xF3BF8F40, OP_DSB, no_fields, ARMV6M, 0},
    {"DMB T1", 0xFFFFFFF0, 0xF3BF8F50, OP_DMB, no_fields, ARMV6M, 0},
    {"ISB T1", 0xFFFFFFF0, 0xF3BF8F60, OP_ISB, no_fields, ARMV6M, 0},
    {"MRS T1", 0xFFFFF000, 0xF3EF8000, OP_MRS, from_special, ARMV6M, 0},
    {"UDF T2 and other system instructions", 0xFB80D000, 0xF3808000, OP_UNDEFINED, no_fields, ARMV6M, 0},
    {"B T3", 0xF800D000, 0xF0008000, OP_B, branch_if, ARMV7M, 0},
};

/* A5.3.11 */
static const struct encoding SHIFTED[] = {
    {"TST (register) T2", 0xFFF08F00, 0xEA100F00, OP_TST_RS, shifted_compare, ARMV7M, 0},
    {"AND (register) T2", 0xFFE08000, 0xEA000000, OP_AND_R, shifted, ARMV7M, 0},
    {"BIC (register) T2", 0xFFE08000, 0xEA200000, OP_BIC_R, shifted, ARMV7M, 0},
    {"MOV (register) T3, LSL to RRX (immediate) T2", 0xFFEF8000, 0xEA4F0000, OP_MOV_R, shifted_move, ARMV7M, 0},
    {"ORR (register) T2", 0xFFE08000, 0xEA400000, OP_ORR_R, shifted, ARMV7M, 0},
    {"MVN (register) T2", 0xFFEF8000, 0xEA6F0000, OP_MVN_R, shifted_move, ARMV7M, 0},
    {"ORN (register) T1", 0xFFE08000, 0xEA600000, OP_ORN_R, shifted, ARMV7M, 0},
    {"TEQ (register) T1", 0xFFF08F00, 0xEA900F00, OP_TEQ_RS, shifted_compare, ARMV7M, 0},
    {"EOR (register) T2", 0xFFE08000, 0xEA800000, OP_EOR_R, shifted, ARMV7M, 0},
    {"PKHBT T1", 0xFFF08030, 0xEAC00000, OP_PKHBT, pack, ARMV7M, 0},
    {"PKHTB T1", 0xFFF08030, 0xEAC00020, OP_PKHTB, pack, ARMV7M, 0},
    {"CMN (register) T2", 0xFFF08F00, 0xEB100F00, OP_CMN_RS, shifted_compare, ARMV7M, 0},
    {"ADD (register) T3", 0xFFE08000, 0xEB000000, OP_ADD_R, shifted, ARMV7M, 0},
    {"ADC (register) T2", 0xFFE08000, 0xEB400000, OP_ADC_R, shifted, ARMV7M, 0},
    {"SBC (register) T2", 0xFFE08000, 0xEB600000, OP_SBC_R, shifted, ARMV7M, 0},
    {"CMP (register) T3", 0xFFF08F00, 0xEBB00F00, OP_CMP_RS, shifted_compare, ARMV7M, 0},
    {"SUB (register) T2", 0xFFE08000, 0xEBA00000, OP_SUB_R, shifted, ARMV7M, 0},
    {"RSB (register) T1", 0xFFE08000, 0xEBC00000, OP_RSB_R, shifted, ARMV7M, 0},
};

#define PARALLEL_ROW(KIND, NAME, VALUE) \
    {#KIND #NAME " T1", 0xFFF0F0F0, VALUE, OP_##KIND##NAME, three_registers, ARMV7M, 0}
#define PARALLEL_ROWS(KIND, CODE) \
    PARALLEL_ROW(KIND, ADD8, 0xFA80F000u | CODE), PARALLEL_ROW(KIND, ADD16, 0xFA90F000u | CODE), \
    PARALLEL_ROW(KIND, ASX, 0xFAA0F000u | CODE), PARALLEL_ROW(KIND, SUB8, 0xFAC0F000u | CODE), \
    PARALLEL_ROW(KIND, SUB16, 0xFAD0F000u | CODE), PARALLEL_ROW(KIND, SAX, 0xFAE0F000u | CODE)

/* A5.3.12 to A5.3.15 */
static const struct encoding REGISTERS[] = {
    {"LSL to ROR (register) T2", 0xFF80F0F0, 0xFA00F000, OP_SHIFT, shift_by_register, ARMV7M, 0},
    {"SXTAH, SXTH T2", 0xFFF0F0C0, 0xFA00F080, OP_SXTAH, extend_and_add, ARMV7M, 0},
    {"UXTAH, UXTH T2", 0xFFF0F0C0, 0xFA10F080, OP_UXTAH, extend_and_add, ARMV7M, 0},
    {"SXTAB16, SXTB16 T1", 0xFFF0F0C0, 0xFA20F080, OP_SXTAB16, extend_and_add, ARMV7M, 0},
    {"UXTAB16, UXTB16 T1", 0xFFF0F0C0, 0xFA30F080, OP_UXTAB16, extend_and_add, ARMV7M, 0},
    {"SXTAB, SXTB T2", 0xFFF0F0C0, 0xFA40F080, OP_SXTAB, extend_and_add, ARMV7M, 0},
    {"UXTAB, UXTB T2", 0xFFF0F0C0, 0xFA50F080, OP_UXTAB, extend_and_add, ARMV7M, 0},
    {"QADD T1", 0xFFF0F0F0, 0xFA80F080, OP_QADD, three_registers, ARMV7M, 0},
    {"QDADD T1", 0xFFF0F0F0, 0xFA80F090, OP_QDADD, three_registers, ARMV7M, 0},
    {"QSUB T1", 0xFFF0F0F0, 0xFA80F0A0, OP_QSUB, three_registers, ARMV7M, 0},
    {"QDSUB T1", 0xFFF0F0F0, 0xFA80F0B0, OP_QDSUB, three_registers, ARMV7M, 0},
    {"REV T2", 0xFFF0F0F0, 0xFA90F080, OP_REV, two_registers, ARMV7M, 0},
    {"REV16 T2", 0xFFF0F0F0, 0xFA90F090, OP_REV16, two_registers, ARMV7M, 0},
    {"RBIT T1", 0xFFF0F0F0, 0xFA90F0A0, OP_RBIT, two_registers, ARMV7M, 0},
    {"REVSH T2", 0xFFF0F0F0, 0xFA90F0B0, OP_REVSH, two_registers, ARMV7M, 0},
    {"SEL T1", 0xFFF0F0F0, 0xFAA0F080, OP_SEL, three_registers, ARMV7M, 0},
    {"CLZ T1", 0xFFF0F0F0, 0xFAB0F080, OP_CLZ, two_registers, ARMV7M, 0},
    PARALLEL_ROWS(S, 0x00u), PARALLEL_ROWS(Q, 0x10u), PARALLEL_ROWS(SH, 0x20u),
    PARALLEL_ROWS(U, 0x40u), PARALLEL_ROWS(UQ, 0x50u), PARALLEL_ROWS(UH, 0x60u),
};

/* A5.3.16 and A5.3.17 */
static const struct encoding MULTIPLICATIONS[] = {
    {"MUL T2", 0xFFF0F0F0, 0xFB00F000, OP_MUL, three_registers, ARMV7M, 0},
    {"MLA T1", 0xFFF000F0, 0xFB000000, OP_MLA, multiply_and_add, ARMV7M, 0},
    {"MLS T1", 0xFFF000F0, 0xFB000010, OP_MLS, multiply_and_must_add, ARMV7M, 0},
    {"SMLABB to SMLATT, SMULBB to SMULTT T1", 0xFFF000C0, 0xFB100000, OP_SMLA_HALVES, multiply_halves, ARMV7M, 0},
    {"SMLAD, SMUAD T1", 0xFFF000E0, 0xFB200000, OP_SMLAD, multiply_option, ARMV7M, 0},
    {"SMLAWB, SMLAWT, SMULWB, SMULWT T1", 0xFFF000E0, 0xFB300000, OP_SMLAW, multiply_option, ARMV7M, 0},
    {"SMLSD, SMUSD T1", 0xFFF000E0, 0xFB400000, OP_SMLSD, multiply_option, ARMV7M, 0},
    {"SMMLA, SMMUL T1", 0xFFF000E0, 0xFB500000, OP_SMMLA, multiply_option, ARMV7M, 0},
    {"SMMLS T1", 0xFFF000E0, 0xFB600000, OP_SMMLS, multiply_option_and_must_add, ARMV7M, 0},
    {"USADA8, USAD8 T1", 0xFFF000F0, 0xFB700000, OP_USADA8, multiply_and_add, ARMV7M, 0},
    {"SMULL T1", 0xFFF000F0, 0xFB800000, OP_SMULL, multiply_long, ARMV7M, 0},
    {"SDIV T1", 0xFFF0F0F0, 0xFB90F0F0, OP_SDIV, three_registers, ARMV7M, 0},
    {"UMULL T1", 0xFFF000F0, 0xFBA00000, OP_UMULL, multiply_long, ARMV7M, 0},
    {"UDIV T1", 0xFFF0F0F0, 0xFBB0F0F0, OP_UDIV, three_registers, ARMV7M, 0},
    {"SMLAL T1", 0xFFF000F0, 0xFBC00000, OP_SMLAL, multiply_long, ARMV7M, 0},
    {"SMLALBB to SMLALTT T1", 0xFFF000C0, 0xFBC00080, OP_SMLAL_HALVES, multiply_long_halves, ARMV7M, 0},
    {"SMLALD T1", 0xFFF000E0, 0xFBC000C0, OP_SMLALD, multiply_long_option, ARMV7M, 0},
    {"SMLSLD T1", 0xFFF000E0, 0xFBD000C0, OP_SMLSLD, multiply_long_option, ARMV7M, 0},
    {"UMLAL T1", 0xFFF000F0, 0xFBE00000, OP_UMLAL, multiply_long, ARMV7M, 0},
    {"UMAAL T1", 0xFFF000F0, 0xFBE00060, OP_UMAAL, multiply_long, ARMV7M, 0},
};

const struct encoding_group data_groups[] = {
    GROUP(0xFA008000, 0xF0000000, MODIFIED),
    GROUP(0xFA008000, 0xF2000000, PLAIN),
    GROUP(0xF8008000, 0xF0008000, CONTROL),
    GROUP(0xFE000000, 0xEA000000, SHIFTED),
    GROUP(0xFF000000, 0xFA000000, REGISTERS),
    GROUP(0xFF000000, 0xFB000000, MULTIPLICATIONS),
    {0, 0, NULL, 0},
};
