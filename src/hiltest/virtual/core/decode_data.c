/* Encodings of four bytes that access no memory: data processing, multiplication, branches, control (DDI 0403E, A5.3).
 */

#include "decode.h"

#include <stddef.h>

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
    if (is_set(word->bits, 20) && !has_flag_form(decoded)) decoded->operation += FORM_SETS_FLAGS;
}

/* A modified immediate constant (ThumbExpandImm_C, A5.3.2). Patterns of a zero byte are UNPREDICTABLE, here zero. */
static void modified(const struct code_word *word, struct instruction *decoded)
{
    static const uint32_t PATTERNS[] = {0x00000001, 0x00010001, 0x01000100, 0x01010101};
    uint32_t code = plain_number(word);
    uint32_t byte = bits(code, 7, 0), rotation = bits(code, 11, 7), value = bits(code, 6, 0) | 1u << 7;

    take_flag_bit(word, decoded);
    if (bits(code, 11, 10) == 0) {
        decoded->immediate = byte * PATTERNS[bits(code, 9, 8)];
    } else {
        decoded->immediate = rotate_right(value, rotation); /* by 8 to 31 */
        decoded->carry = (uint8_t)(decoded->immediate >> 31);
    }
}

/* A plain immediate (A5.3.3); MOV and MOVT have four bits more. */
static void plain(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = plain_number(word);
}

static void plain_half(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = bits(word->bits, 19, 16) << 12 | plain_number(word);
}

static void address_above(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = literal_base(word) + plain_number(word);
}

static void address_below(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = literal_base(word) - plain_number(word);
}

/* The width of a signed range, which is counted from one. */
static void signed_width(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    decoded->immediate++;
}

/* SSAT16 and USAT16 have the encodings of SSAT and USAT with ASR by 0. */
static void saturate(const struct code_word *word, struct instruction *decoded)
{
    decoded->shift = is_set(word->bits, 21) ? SHIFT_ASR : SHIFT_LSL;
    decoded->amount = (uint8_t)split_number(word);
    if (decoded->operation == OP_SSAT) decoded->immediate++;
    if (decoded->shift == SHIFT_ASR && decoded->amount == 0) undefine(decoded); /* not encodable */
}

/* A field that ends above bit 31 is UNPREDICTABLE (A7.7, SBFX and UBFX); it is undefined as in Unicorn. */
static void extract_bits(const struct code_word *word, struct instruction *decoded)
{
    decoded->amount = (uint8_t)split_number(word);
    decoded->immediate++;
    if (decoded->amount + decoded->immediate > 32) undefine(decoded);
}

/* A field that ends below its beginning is UNPREDICTABLE (A7.7, BFC and BFI); it is undefined as in Unicorn. */
static void insert_bits(const struct code_word *word, struct instruction *decoded)
{
    uint32_t lowest = split_number(word), highest = bits(word->bits, 4, 0);
    decoded->amount = (uint8_t)lowest;
    if (highest < lowest)
        undefine(decoded);
    else
        decoded->immediate = 0xFFFFFFFFu >> (31 - (highest - lowest)) << lowest;
}

/* A shifted register (A5.3.11). The rows name the form without a shift. */
static void shifted(const struct code_word *word, struct instruction *decoded)
{
    uint32_t type = bits(word->bits, 5, 4), amount = split_number(word);
    take_flag_bit(word, decoded);
    set_shift(decoded, type, amount);
    if (type != SHIFT_LSL || amount != 0) decoded->operation += FORM_SHIFTED - FORM_REGISTER;
}

/* PKHBT shifts to the left, PKHTB arithmetically to the right. */
static void pack(const struct code_word *word, struct instruction *decoded)
{
    set_shift(decoded, bits(word->bits, 5, 4), split_number(word));
}

static void shift_by_register(const struct code_word *word, struct instruction *decoded)
{
    decoded->shift = (uint8_t)bits(word->bits, 22, 21);
    decoded->sets_flags = is_set(word->bits, 20);
}

/* Branches and control (A5.3.4) */

/* A conditional branch in an IT block is UNPREDICTABLE; it is undefined as in Unicorn. */
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

/* The usual positions of registers. */
#define D NOT_PC(d, 8)
#define N NOT_PC(n, 16)
#define M NOT_PC(m, 0)
#define D_N D, N
#define D_N_M D, N, M
#define ROTATION .amount = {4, 2, 3} /* in bits */
/* d is the lower word, a the upper one. The same register twice is UNPREDICTABLE: as in Unicorn, the upper word is
 * written last. */
#define LONG NOT_PC(d, 12), NOT_PC(a, 8), N, M

/* A5.3.1. The comparisons are forms with d = 15 that set flags, the moves forms with n = 15. */
static const struct encoding MODIFIED[] = {
    {"TST (immediate) T1", 0xFBF08F00, 0xF0100F00, OP_TST_IS, N, .extract = modified},
    {"AND (immediate) T1", 0xFBE08000, 0xF0000000, OP_AND_I, D_N, .extract = modified},
    {"BIC (immediate) T1", 0xFBE08000, 0xF0200000, OP_BIC_I, D_N, .extract = modified},
    {"MOV (immediate) T2", 0xFBEF8000, 0xF04F0000, OP_MOV_I, D, .extract = modified},
    {"ORR (immediate) T1", 0xFBE08000, 0xF0400000, OP_ORR_I, D_N, .extract = modified},
    {"MVN (immediate) T1", 0xFBEF8000, 0xF06F0000, OP_MVN_I, D, .extract = modified},
    {"ORN (immediate) T1", 0xFBE08000, 0xF0600000, OP_ORN_I, D_N, .extract = modified},
    {"TEQ (immediate) T1", 0xFBF08F00, 0xF0900F00, OP_TEQ_IS, N, .extract = modified},
    {"EOR (immediate) T1", 0xFBE08000, 0xF0800000, OP_EOR_I, D_N, .extract = modified},
    {"CMN (immediate) T1", 0xFBF08F00, 0xF1100F00, OP_CMN_IS, N, .extract = modified},
    {"ADD (immediate) T3", 0xFBE08000, 0xF1000000, OP_ADD_I, D_N, .extract = modified},
    {"ADC (immediate) T1", 0xFBE08000, 0xF1400000, OP_ADC_I, D_N, .extract = modified},
    {"SBC (immediate) T1", 0xFBE08000, 0xF1600000, OP_SBC_I, D_N, .extract = modified},
    {"CMP (immediate) T2", 0xFBF08F00, 0xF1B00F00, OP_CMP_IS, N, .extract = modified},
    {"SUB (immediate) T3", 0xFBE08000, 0xF1A00000, OP_SUB_I, D_N, .extract = modified},
    {"RSB (immediate) T2", 0xFBE08000, 0xF1C00000, OP_RSB_I, D_N, .extract = modified},
};

/* A5.3.3 */
static const struct encoding PLAIN[] = {
    {"ADR T3", 0xFBFF8000, 0xF20F0000, OP_MOV_I, D, .extract = address_above},
    {"ADD (immediate) T4", 0xFBF08000, 0xF2000000, OP_ADD_I, D_N, .extract = plain},
    {"MOV (immediate) T3", 0xFBF08000, 0xF2400000, OP_MOV_I, D, .extract = plain_half},
    {"ADR T2", 0xFBFF8000, 0xF2AF0000, OP_MOV_I, D, .extract = address_below},
    {"SUB (immediate) T4", 0xFBF08000, 0xF2A00000, OP_SUB_I, D_N, .extract = plain},
    {"MOVT T1", 0xFBF08000, 0xF2C00000, OP_MOVT, D, .extract = plain_half},
    {"SSAT16 T1", 0xFFF0F0F0, 0xF3200000, OP_SSAT16, D_N, NUMBER(0, 4, 0), .extract = signed_width},
    {"SSAT T1", 0xFFD08020, 0xF3000000, OP_SSAT, D_N, NUMBER(0, 5, 0), .extract = saturate},
    {"SBFX T1", 0xFFF08020, 0xF3400000, OP_SBFX, D_N, NUMBER(0, 5, 0), .extract = extract_bits},
    {"BFC T1", 0xFFFF8020, 0xF36F0000, OP_BFC, D, .extract = insert_bits},
    {"BFI T1", 0xFFF08020, 0xF3600000, OP_BFI, D_N, .extract = insert_bits},
    {"USAT16 T1", 0xFFF0F0F0, 0xF3A00000, OP_USAT16, D_N, NUMBER(0, 4, 0)},
    {"USAT T1", 0xFFD08020, 0xF3800000, OP_USAT, D_N, NUMBER(0, 5, 0), .extract = saturate},
    {"UBFX T1", 0xFFF08020, 0xF3C00000, OP_UBFX, D_N, NUMBER(0, 5, 0), .extract = extract_bits},
};

/* A5.3.4. MSR, hints and the like have the encodings of branches with condition 14 or 15. */
static const struct encoding CONTROL[] = {
    {"BL T1", 0xF800D000, 0xF000D000, OP_BL, .extract = branch, .is_baseline = true},
    {"B T4", 0xF800D000, 0xF0009000, OP_B, .extract = branch},
    {"MSR (register) T1", 0xFFF0F300, 0xF3808000, OP_MSR, N, NUMBER(0, 8, 0), AMOUNT(10, 2), .is_baseline = true},
    {"YIELD T2", 0xFFFFFFFF, 0xF3AF8001, OP_YIELD, .extract = hint},
    {"WFE T2", 0xFFFFFFFF, 0xF3AF8002, OP_WFE, .extract = hint},
    {"WFI T2", 0xFFFFFFFF, 0xF3AF8003, OP_WFI, .extract = hint},
    {"SEV T2", 0xFFFFFFFF, 0xF3AF8004, OP_SEV, .extract = hint},
    {"DBG T1", 0xFFFFFFF0, 0xF3AF80F0, OP_NOP, .extract = NULL},
    {"NOP T2, hints", 0xFFFFFF00, 0xF3AF8000, OP_NOP, .extract = hint},
    {"CLREX T1", 0xFFFFFFFF, 0xF3BF8F2F, OP_CLREX, .extract = NULL},
    {"DSB T1", 0xFFFFFFF0, 0xF3BF8F40, OP_DSB, .extract = NULL, .is_baseline = true},
    {"DMB T1", 0xFFFFFFF0, 0xF3BF8F50, OP_DMB, .extract = NULL, .is_baseline = true},
    {"ISB T1", 0xFFFFFFF0, 0xF3BF8F60, OP_ISB, .extract = NULL, .is_baseline = true},
    {"MRS T1", 0xFFFFF000, 0xF3EF8000, OP_MRS, D, NUMBER(0, 8, 0), .is_baseline = true},
    {"UDF T2 and other system instructions", 0xFB80D000, 0xF3808000, OP_UNDEFINED, .is_baseline = true},
    {"B T3", 0xF800D000, 0xF0008000, OP_B, .extract = branch_if},
};

/* A5.3.11 */
static const struct encoding SHIFTED[] = {
    {"TST (register) T2", 0xFFF08F00, 0xEA100F00, OP_TST_RS, N, M, .extract = shifted},
    {"AND (register) T2", 0xFFE08000, 0xEA000000, OP_AND_R, D_N_M, .extract = shifted},
    {"BIC (register) T2", 0xFFE08000, 0xEA200000, OP_BIC_R, D_N_M, .extract = shifted},
    {"MOV (register) T3, LSL to RRX (immediate) T2", 0xFFEF8000, 0xEA4F0000, OP_MOV_R, D, M, .extract = shifted},
    {"ORR (register) T2", 0xFFE08000, 0xEA400000, OP_ORR_R, D_N_M, .extract = shifted},
    {"MVN (register) T2", 0xFFEF8000, 0xEA6F0000, OP_MVN_R, D, M, .extract = shifted},
    {"ORN (register) T1", 0xFFE08000, 0xEA600000, OP_ORN_R, D_N_M, .extract = shifted},
    {"TEQ (register) T1", 0xFFF08F00, 0xEA900F00, OP_TEQ_RS, N, M, .extract = shifted},
    {"EOR (register) T2", 0xFFE08000, 0xEA800000, OP_EOR_R, D_N_M, .extract = shifted},
    {"PKHBT T1", 0xFFF08030, 0xEAC00000, OP_PKHBT, D_N_M, .extract = pack},
    {"PKHTB T1", 0xFFF08030, 0xEAC00020, OP_PKHTB, D_N_M, .extract = pack},
    {"CMN (register) T2", 0xFFF08F00, 0xEB100F00, OP_CMN_RS, N, M, .extract = shifted},
    {"ADD (register) T3", 0xFFE08000, 0xEB000000, OP_ADD_R, D_N_M, .extract = shifted},
    {"ADC (register) T2", 0xFFE08000, 0xEB400000, OP_ADC_R, D_N_M, .extract = shifted},
    {"SBC (register) T2", 0xFFE08000, 0xEB600000, OP_SBC_R, D_N_M, .extract = shifted},
    {"CMP (register) T3", 0xFFF08F00, 0xEBB00F00, OP_CMP_RS, N, M, .extract = shifted},
    {"SUB (register) T2", 0xFFE08000, 0xEBA00000, OP_SUB_R, D_N_M, .extract = shifted},
    {"RSB (register) T1", 0xFFE08000, 0xEBC00000, OP_RSB_R, D_N_M, .extract = shifted},
};

#define PARALLEL_ROW(KIND, NAME, VALUE) \
    {#KIND #NAME " T1", 0xFFF0F0F0, VALUE, OP_##KIND##NAME, D_N_M}
#define PARALLEL_ROWS(KIND, CODE) \
    PARALLEL_ROW(KIND, ADD8, 0xFA80F000u | CODE), PARALLEL_ROW(KIND, ADD16, 0xFA90F000u | CODE), \
    PARALLEL_ROW(KIND, ASX, 0xFAA0F000u | CODE), PARALLEL_ROW(KIND, SUB8, 0xFAC0F000u | CODE), \
    PARALLEL_ROW(KIND, SUB16, 0xFAD0F000u | CODE), PARALLEL_ROW(KIND, SAX, 0xFAE0F000u | CODE)

/* A5.3.12 to A5.3.15. CLZ, RBIT and REV have two fields for m; as in Unicorn, the lower one counts. n = 15 adds
 * nothing: SXTB and the like. */
static const struct encoding REGISTERS[] = {
    {"LSL to ROR (register) T2", 0xFF80F0F0, 0xFA00F000, OP_SHIFT, D_N_M, .extract = shift_by_register},
    {"SXTAH, SXTH T2", 0xFFF0F0C0, 0xFA00F080, OP_SXTAH, D, ANY(n, 16), M, ROTATION},
    {"UXTAH, UXTH T2", 0xFFF0F0C0, 0xFA10F080, OP_UXTAH, D, ANY(n, 16), M, ROTATION},
    {"SXTAB16, SXTB16 T1", 0xFFF0F0C0, 0xFA20F080, OP_SXTAB16, D, ANY(n, 16), M, ROTATION},
    {"UXTAB16, UXTB16 T1", 0xFFF0F0C0, 0xFA30F080, OP_UXTAB16, D, ANY(n, 16), M, ROTATION},
    {"SXTAB, SXTB T2", 0xFFF0F0C0, 0xFA40F080, OP_SXTAB, D, ANY(n, 16), M, ROTATION},
    {"UXTAB, UXTB T2", 0xFFF0F0C0, 0xFA50F080, OP_UXTAB, D, ANY(n, 16), M, ROTATION},
    {"QADD T1", 0xFFF0F0F0, 0xFA80F080, OP_QADD, D_N_M},
    {"QDADD T1", 0xFFF0F0F0, 0xFA80F090, OP_QDADD, D_N_M},
    {"QSUB T1", 0xFFF0F0F0, 0xFA80F0A0, OP_QSUB, D_N_M},
    {"QDSUB T1", 0xFFF0F0F0, 0xFA80F0B0, OP_QDSUB, D_N_M},
    {"REV T2", 0xFFF0F0F0, 0xFA90F080, OP_REV, D, M},
    {"REV16 T2", 0xFFF0F0F0, 0xFA90F090, OP_REV16, D, M},
    {"RBIT T1", 0xFFF0F0F0, 0xFA90F0A0, OP_RBIT, D, M},
    {"REVSH T2", 0xFFF0F0F0, 0xFA90F0B0, OP_REVSH, D, M},
    {"SEL T1", 0xFFF0F0F0, 0xFAA0F080, OP_SEL, D_N_M},
    {"CLZ T1", 0xFFF0F0F0, 0xFAB0F080, OP_CLZ, D, M},
    PARALLEL_ROWS(S, 0x00u), PARALLEL_ROWS(Q, 0x10u), PARALLEL_ROWS(SH, 0x20u),
    PARALLEL_ROWS(U, 0x40u), PARALLEL_ROWS(UQ, 0x50u), PARALLEL_ROWS(UH, 0x60u),
};

/* A5.3.16 and A5.3.17. a = 15 adds nothing if the operation says so. */
static const struct encoding MULTIPLICATIONS[] = {
    {"MUL T2", 0xFFF0F0F0, 0xFB00F000, OP_MUL, D_N_M},
    {"MLA T1", 0xFFF000F0, 0xFB000000, OP_MLA, D_N_M, ANY(a, 12)},
    {"MLS T1", 0xFFF000F0, 0xFB000010, OP_MLS, D_N_M, NOT_PC(a, 12)},
    {"SMLABB to SMLATT, SMULBB to SMULTT T1", 0xFFF000C0, 0xFB100000, OP_SMLA_HALVES, D_N_M, ANY(a, 12), AMOUNT(4, 2)},
    {"SMLAD, SMUAD T1", 0xFFF000E0, 0xFB200000, OP_SMLAD, D_N_M, ANY(a, 12), AMOUNT(4, 1)},
    {"SMLAWB, SMLAWT, SMULWB, SMULWT T1", 0xFFF000E0, 0xFB300000, OP_SMLAW, D_N_M, ANY(a, 12), AMOUNT(4, 1)},
    {"SMLSD, SMUSD T1", 0xFFF000E0, 0xFB400000, OP_SMLSD, D_N_M, ANY(a, 12), AMOUNT(4, 1)},
    {"SMMLA, SMMUL T1", 0xFFF000E0, 0xFB500000, OP_SMMLA, D_N_M, ANY(a, 12), AMOUNT(4, 1)},
    {"SMMLS T1", 0xFFF000E0, 0xFB600000, OP_SMMLS, D_N_M, NOT_PC(a, 12), AMOUNT(4, 1)},
    {"USADA8, USAD8 T1", 0xFFF000F0, 0xFB700000, OP_USADA8, D_N_M, ANY(a, 12)},
    {"SMULL T1", 0xFFF000F0, 0xFB800000, OP_SMULL, LONG},
    {"SDIV T1", 0xFFF0F0F0, 0xFB90F0F0, OP_SDIV, D_N_M},
    {"UMULL T1", 0xFFF000F0, 0xFBA00000, OP_UMULL, LONG},
    {"UDIV T1", 0xFFF0F0F0, 0xFBB0F0F0, OP_UDIV, D_N_M},
    {"SMLAL T1", 0xFFF000F0, 0xFBC00000, OP_SMLAL, LONG},
    {"SMLALBB to SMLALTT T1", 0xFFF000C0, 0xFBC00080, OP_SMLAL_HALVES, LONG, AMOUNT(4, 2)},
    {"SMLALD T1", 0xFFF000E0, 0xFBC000C0, OP_SMLALD, LONG, AMOUNT(4, 1)},
    {"SMLSLD T1", 0xFFF000E0, 0xFBD000C0, OP_SMLSLD, LONG, AMOUNT(4, 1)},
    {"UMLAL T1", 0xFFF000F0, 0xFBE00000, OP_UMLAL, LONG},
    {"UMAAL T1", 0xFFF000F0, 0xFBE00060, OP_UMAAL, LONG},
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
