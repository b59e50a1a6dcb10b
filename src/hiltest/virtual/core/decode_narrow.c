/* Encodings of two bytes (DDI 0403E, A5.2). */

#include "decode.h"

#include <stddef.h>

/* Data processing of two bytes sets the flags only outside an IT block (A7.3.2). */
static void set_flags_outside_it_block(const struct code_word *word, struct instruction *decoded)
{
    if (!word->in_it_block) decoded->operation += FORM_SETS_FLAGS;
}

static void shift_by_number(const struct code_word *word, struct instruction *decoded)
{
    uint32_t amount = bits(word->bits, 10, 6), type = bits(word->bits, 12, 11);
    set_shift(decoded, type, amount);
    if (type == SHIFT_LSL && amount == 0) decoded->operation = OP_MOV_R;
    set_flags_outside_it_block(word, decoded);
}

static void shift_by_register(const struct code_word *word, struct instruction *decoded)
{
    static const uint8_t SHIFTS[] = {[2] = SHIFT_LSL, [3] = SHIFT_LSR, [4] = SHIFT_ASR, [7] = SHIFT_ROR};
    decoded->shift = SHIFTS[bits(word->bits, 8, 6)];
    decoded->sets_flags = !word->in_it_block;
}

static void multiply(const struct code_word *word, struct instruction *decoded)
{
    decoded->sets_flags = !word->in_it_block;
}

/* A register whose highest bit is bit 7 of the halfword (A5.2.3). */
static uint8_t high_register(const struct code_word *word)
{
    return (uint8_t)(bits(word->bits, 2, 0) | bits(word->bits, 7, 7) << 3);
}

/* With the PC as operand m, replace the operand by a number in the immediate of another operation. */
static void fold_pc(const struct code_word *word, struct instruction *decoded, uint16_t immediate_form)
{
    if (decoded->m != PC) return;
    decoded->operation = immediate_form;
    decoded->immediate = pc_operand(word);
    decoded->m = 0;
}

static void add_high(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = decoded->n = high_register(word);
    if (decoded->d == PC) decoded->operation = OP_ADD_PC;
    /* ADD PC, PC is UNPREDICTABLE (A7.7, ADD (register)). */
    fold_pc(word, decoded, decoded->d == PC ? OP_UNDEFINED : OP_ADD_I);
}

static void compare_high(const struct code_word *word, struct instruction *decoded)
{
    decoded->n = high_register(word);
    if (decoded->n == PC) undefine(decoded); /* UNPREDICTABLE, and so is m (A7.7, CMP (register)) */
}

static void move_high(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = high_register(word);
    if (decoded->d == PC) decoded->operation = OP_MOV_PC;
    fold_pc(word, decoded, decoded->d == PC ? OP_B : OP_MOV_I);
}

static void add_literal_base(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate += literal_base(word);
}

static void compare_and_branch(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = pc_operand(word) + (bits(word->bits, 7, 3) << 1 | bits(word->bits, 9, 9) << 6);
}

/* PUSH and POP: bit 8 is LR or PC. */
static void push(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate |= bits(word->bits, 8, 8) << LR;
    transfer_list(decoded, MODE_WRITES_BACK | MODE_BEFORE);
}

static void pop(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate |= bits(word->bits, 8, 8) << PC;
    transfer_list(decoded, MODE_WRITES_BACK);
}

/* A base that is loaded is not written back (A7.7, LDM). */
static void multiple(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    bool loads_base = decoded->operation == OP_LDM && is_set(decoded->immediate, decoded->n);
    transfer_list(decoded, loads_base ? 0 : MODE_WRITES_BACK);
}

/* IT inside an IT block is UNPREDICTABLE. As in Unicorn, it begins a new block whatever the condition. BKPT is
 * unconditional, even inside an IT block (A7.7, BKPT). */
static void unconditional(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    decoded->condition = CONDITION_ALWAYS;
}

/* A conditional branch in an IT block is UNPREDICTABLE; it is undefined as in Unicorn. */
static void branch_if(const struct code_word *word, struct instruction *decoded)
{
    decoded->condition = (uint8_t)bits(word->bits, 11, 8);
    decoded->immediate = pc_operand(word) + (uint32_t)sign_extend(bits(word->bits, 7, 0) << 1, 9);
    if (word->in_it_block) undefine(decoded);
}

static void branch(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = pc_operand(word) + (uint32_t)sign_extend(bits(word->bits, 10, 0) << 1, 12);
}

#define SETS_FLAGS .extract = set_flags_outside_it_block
#define LITERAL LOW(d, 8), NUMBER(0, 8, 2), .extract = add_literal_base

/* A5.2.1: shift, add, subtract, move and compare with a number. LSL by 0 is MOV (register) T2. */
static const struct encoding BASIC[] = {
    {"LSL (immediate) T1", 0xF800, 0x0000, OP_MOV_X, LOW(d, 0), LOW(m, 3), .extract = shift_by_number},
    {"LSR (immediate) T1", 0xF800, 0x0800, OP_MOV_X, LOW(d, 0), LOW(m, 3), .extract = shift_by_number},
    {"ASR (immediate) T1", 0xF800, 0x1000, OP_MOV_X, LOW(d, 0), LOW(m, 3), .extract = shift_by_number},
    {"ADD (register) T1", 0xFE00, 0x1800, OP_ADD_R, LOW(d, 0), LOW(n, 3), LOW(m, 6), SETS_FLAGS},
    {"SUB (register) T1", 0xFE00, 0x1A00, OP_SUB_R, LOW(d, 0), LOW(n, 3), LOW(m, 6), SETS_FLAGS},
    {"ADD (immediate) T1", 0xFE00, 0x1C00, OP_ADD_I, LOW(d, 0), LOW(n, 3), NUMBER(6, 3, 0), SETS_FLAGS},
    {"SUB (immediate) T1", 0xFE00, 0x1E00, OP_SUB_I, LOW(d, 0), LOW(n, 3), NUMBER(6, 3, 0), SETS_FLAGS},
    {"MOV (immediate) T1", 0xF800, 0x2000, OP_MOV_I, LOW(d, 8), NUMBER(0, 8, 0), SETS_FLAGS},
    {"CMP (immediate) T1", 0xF800, 0x2800, OP_CMP_IS, LOW(n, 8), NUMBER(0, 8, 0)},
    {"ADD (immediate) T2", 0xF800, 0x3000, OP_ADD_I, LOW(d, 8), LOW(n, 8), NUMBER(0, 8, 0), SETS_FLAGS},
    {"SUB (immediate) T2", 0xF800, 0x3800, OP_SUB_I, LOW(d, 8), LOW(n, 8), NUMBER(0, 8, 0), SETS_FLAGS},
};

/* A5.2.2 */
static const struct encoding DATA[] = {
    {"AND (register) T1", 0xFFC0, 0x4000, OP_AND_R, LOW(d, 0), LOW(n, 0), LOW(m, 3), SETS_FLAGS},
    {"EOR (register) T1", 0xFFC0, 0x4040, OP_EOR_R, LOW(d, 0), LOW(n, 0), LOW(m, 3), SETS_FLAGS},
    {"LSL (register) T1", 0xFFC0, 0x4080, OP_SHIFT, LOW(d, 0), LOW(n, 0), LOW(m, 3), .extract = shift_by_register},
    {"LSR (register) T1", 0xFFC0, 0x40C0, OP_SHIFT, LOW(d, 0), LOW(n, 0), LOW(m, 3), .extract = shift_by_register},
    {"ASR (register) T1", 0xFFC0, 0x4100, OP_SHIFT, LOW(d, 0), LOW(n, 0), LOW(m, 3), .extract = shift_by_register},
    {"ADC (register) T1", 0xFFC0, 0x4140, OP_ADC_R, LOW(d, 0), LOW(n, 0), LOW(m, 3), SETS_FLAGS},
    {"SBC (register) T1", 0xFFC0, 0x4180, OP_SBC_R, LOW(d, 0), LOW(n, 0), LOW(m, 3), SETS_FLAGS},
    {"ROR (register) T1", 0xFFC0, 0x41C0, OP_SHIFT, LOW(d, 0), LOW(n, 0), LOW(m, 3), .extract = shift_by_register},
    {"TST (register) T1", 0xFFC0, 0x4200, OP_TST_RS, LOW(n, 0), LOW(m, 3)},
    {"RSB (immediate) T1", 0xFFC0, 0x4240, OP_RSB_I, LOW(d, 0), LOW(n, 3), SETS_FLAGS},
    {"CMP (register) T1", 0xFFC0, 0x4280, OP_CMP_RS, LOW(n, 0), LOW(m, 3)},
    {"CMN (register) T1", 0xFFC0, 0x42C0, OP_CMN_RS, LOW(n, 0), LOW(m, 3)},
    {"ORR (register) T1", 0xFFC0, 0x4300, OP_ORR_R, LOW(d, 0), LOW(n, 0), LOW(m, 3), SETS_FLAGS},
    {"MUL T1", 0xFFC0, 0x4340, OP_MUL, LOW(d, 0), LOW(n, 3), LOW(m, 0), .extract = multiply},
    {"BIC (register) T1", 0xFFC0, 0x4380, OP_BIC_R, LOW(d, 0), LOW(n, 0), LOW(m, 3), SETS_FLAGS},
    {"MVN (register) T1", 0xFFC0, 0x43C0, OP_MVN_R, LOW(d, 0), LOW(m, 3), SETS_FLAGS},
};

/* A5.2.3 */
static const struct encoding SPECIAL_DATA[] = {
    {"ADD (register) T2", 0xFF00, 0x4400, OP_ADD_R, ANY(m, 3), .extract = add_high},
    {"CMP (register) T2", 0xFF00, 0x4500, OP_CMP_RS, NOT_PC(m, 3), .extract = compare_high},
    {"MOV (register) T1", 0xFF00, 0x4600, OP_MOV_R, ANY(m, 3), .extract = move_high},
    {"BX T1", 0xFF87, 0x4700, OP_BX, ANY(m, 3)},
    {"BLX (register) T1", 0xFF87, 0x4780, OP_BLX, ANY(m, 3)},
};

/* A5.2.4, and the literal load */
static const struct encoding ACCESS[] = {
    {"LDR (literal) T1", 0xF800, 0x4800, OP_LDR_L, LITERAL, FIXED(n, PC)},
    {"STR (register) T1", 0xFE00, 0x5000, OP_STR_R, LOW(d, 0), LOW(n, 3), LOW(m, 6)},
    {"STRH (register) T1", 0xFE00, 0x5200, OP_STRH_R, LOW(d, 0), LOW(n, 3), LOW(m, 6)},
    {"STRB (register) T1", 0xFE00, 0x5400, OP_STRB_R, LOW(d, 0), LOW(n, 3), LOW(m, 6)},
    {"LDRSB (register) T1", 0xFE00, 0x5600, OP_LDRSB_R, LOW(d, 0), LOW(n, 3), LOW(m, 6)},
    {"LDR (register) T1", 0xFE00, 0x5800, OP_LDR_R, LOW(d, 0), LOW(n, 3), LOW(m, 6)},
    {"LDRH (register) T1", 0xFE00, 0x5A00, OP_LDRH_R, LOW(d, 0), LOW(n, 3), LOW(m, 6)},
    {"LDRB (register) T1", 0xFE00, 0x5C00, OP_LDRB_R, LOW(d, 0), LOW(n, 3), LOW(m, 6)},
    {"LDRSH (register) T1", 0xFE00, 0x5E00, OP_LDRSH_R, LOW(d, 0), LOW(n, 3), LOW(m, 6)},
    {"STR (immediate) T1", 0xF800, 0x6000, OP_STR_I, LOW(d, 0), LOW(n, 3), NUMBER(6, 5, 2)},
    {"LDR (immediate) T1", 0xF800, 0x6800, OP_LDR_I, LOW(d, 0), LOW(n, 3), NUMBER(6, 5, 2)},
    {"STRB (immediate) T1", 0xF800, 0x7000, OP_STRB_I, LOW(d, 0), LOW(n, 3), NUMBER(6, 5, 0)},
    {"LDRB (immediate) T1", 0xF800, 0x7800, OP_LDRB_I, LOW(d, 0), LOW(n, 3), NUMBER(6, 5, 0)},
    {"STRH (immediate) T1", 0xF800, 0x8000, OP_STRH_I, LOW(d, 0), LOW(n, 3), NUMBER(6, 5, 1)},
    {"LDRH (immediate) T1", 0xF800, 0x8800, OP_LDRH_I, LOW(d, 0), LOW(n, 3), NUMBER(6, 5, 1)},
    {"STR (immediate) T2", 0xF800, 0x9000, OP_STR_I, LOW(d, 8), FIXED(n, SP), NUMBER(0, 8, 2)},
    {"LDR (immediate) T2", 0xF800, 0x9800, OP_LDR_I, LOW(d, 8), FIXED(n, SP), NUMBER(0, 8, 2)},
};

/* A5.2.5, and the addresses relative to PC and SP */
static const struct encoding MISCELLANEOUS[] = {
    {"ADR T1", 0xF800, 0xA000, OP_MOV_I, LITERAL},
    {"ADD (SP plus immediate) T1", 0xF800, 0xA800, OP_ADD_I, LOW(d, 8), FIXED(n, SP), NUMBER(0, 8, 2)},
    {"ADD (SP plus immediate) T2", 0xFF80, 0xB000, OP_ADD_I, FIXED(d, SP), FIXED(n, SP), NUMBER(0, 7, 2)},
    {"SUB (SP minus immediate) T1", 0xFF80, 0xB080, OP_SUB_I, FIXED(d, SP), FIXED(n, SP), NUMBER(0, 7, 2)},
    {"CBZ T1", 0xFD00, 0xB100, OP_CBZ, LOW(n, 0), .extract = compare_and_branch},
    {"CBNZ T1", 0xFD00, 0xB900, OP_CBNZ, LOW(n, 0), .extract = compare_and_branch},
    {"SXTH T1", 0xFFC0, 0xB200, OP_SXTAH, LOW(d, 0), FIXED(n, PC), LOW(m, 3)},
    {"SXTB T1", 0xFFC0, 0xB240, OP_SXTAB, LOW(d, 0), FIXED(n, PC), LOW(m, 3)},
    {"UXTH T1", 0xFFC0, 0xB280, OP_UXTAH, LOW(d, 0), FIXED(n, PC), LOW(m, 3)},
    {"UXTB T1", 0xFFC0, 0xB2C0, OP_UXTAB, LOW(d, 0), FIXED(n, PC), LOW(m, 3)},
    {"PUSH T1", 0xFE00, 0xB400, OP_STM, FIXED(n, SP), NUMBER(0, 8, 0), .extract = push},
    {"CPS T1", 0xFFEC, 0xB660, OP_CPS, NUMBER(4, 1, 0), AMOUNT(0, 2)},
    {"REV T1", 0xFFC0, 0xBA00, OP_REV, LOW(d, 0), LOW(m, 3)},
    {"REV16 T1", 0xFFC0, 0xBA40, OP_REV16, LOW(d, 0), LOW(m, 3)},
    {"REVSH T1", 0xFFC0, 0xBAC0, OP_REVSH, LOW(d, 0), LOW(m, 3)},
    {"POP T1", 0xFE00, 0xBC00, OP_LDM, FIXED(n, SP), NUMBER(0, 8, 0), .extract = pop},
    {"BKPT T1", 0xFF00, 0xBE00, OP_BKPT, NUMBER(0, 8, 0), .extract = unconditional},
    {"YIELD T1", 0xFFFF, 0xBF10, OP_YIELD, .extract = hint},
    {"WFE T1", 0xFFFF, 0xBF20, OP_WFE, .extract = hint},
    {"WFI T1", 0xFFFF, 0xBF30, OP_WFI, .extract = hint},
    {"SEV T1", 0xFFFF, 0xBF40, OP_SEV, .extract = hint},
    {"NOP T1, hints", 0xFF0F, 0xBF00, OP_NOP, .extract = hint},
    {"IT T1", 0xFF00, 0xBF00, OP_IT, NUMBER(0, 8, 0), .extract = unconditional},
};

/* A5.2.6, multiple transfers and branches */
static const struct encoding BRANCHES[] = {
    {"STM T1", 0xF800, 0xC000, OP_STM, LOW(n, 8), NUMBER(0, 8, 0), .extract = multiple},
    {"LDM T1", 0xF800, 0xC800, OP_LDM, LOW(n, 8), NUMBER(0, 8, 0), .extract = multiple},
    {"UDF T1", 0xFF00, 0xDE00, OP_UNDEFINED, .extract = NULL},
    {"SVC T1", 0xFF00, 0xDF00, OP_SVC, NUMBER(0, 8, 0)},
    {"B T1", 0xF000, 0xD000, OP_B, .extract = branch_if},
    {"B T2", 0xF800, 0xE000, OP_B, .extract = branch},
};

/* Accesses come last, for the bits that the other groups do not match. */
const struct encoding_group narrow_groups[] = {
    GROUP(0xC000, 0x0000, BASIC),
    GROUP(0xFC00, 0x4000, DATA),
    GROUP(0xFC00, 0x4400, SPECIAL_DATA),
    GROUP(0xE000, 0xA000, MISCELLANEOUS),
    GROUP(0xC000, 0xC000, BRANCHES),
    GROUP(0x0000, 0x0000, ACCESS),
    {0, 0, NULL, 0},
};
