/* Encodings of two bytes (DDI 0403E, A5.2). */

#include "decode.h"

#include <stddef.h>

static uint8_t low_register(const struct code_word *word, unsigned low)
{
    return (uint8_t)bits(word->bits, low + 2, low);
}

/* A register of which bit 7 of the halfword is the highest bit (A5.2.3). */
static uint8_t high_register(const struct code_word *word)
{
    return (uint8_t)(bits(word->bits, 2, 0) | bits(word->bits, 7, 7) << 3);
}

/* Data processing of two bytes sets the flags only outside an IT block (A7.3.2). */
static void set_flags_outside_it_block(const struct code_word *word, struct instruction *decoded)
{
    if (!word->in_it_block) decoded->operation += FORM_SETS_FLAGS;
}

static void shift_by_number(const struct code_word *word, struct instruction *decoded)
{
    uint32_t amount = bits(word->bits, 10, 6), type = bits(word->bits, 12, 11);
    decoded->d = low_register(word, 0);
    decoded->m = low_register(word, 3);
    set_shift(decoded, type, amount);
    if (type == SHIFT_LSL && amount == 0) decoded->operation = OP_MOV_R;
    set_flags_outside_it_block(word, decoded);
}

static void three_registers(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 0);
    decoded->n = low_register(word, 3);
    decoded->m = low_register(word, 6);
    set_flags_outside_it_block(word, decoded);
}

static void two_registers_and_number(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 0);
    decoded->n = low_register(word, 3);
    decoded->immediate = bits(word->bits, 8, 6);
    set_flags_outside_it_block(word, decoded);
}

static void register_and_number(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = decoded->n = low_register(word, 8);
    decoded->immediate = bits(word->bits, 7, 0);
    set_flags_outside_it_block(word, decoded);
}

static void move_number(const struct code_word *word, struct instruction *decoded)
{
    register_and_number(word, decoded);
    decoded->n = 0;
}

static void compare_number(const struct code_word *word, struct instruction *decoded)
{
    decoded->n = low_register(word, 8);
    decoded->immediate = bits(word->bits, 7, 0);
}

static void register_pair(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = decoded->n = low_register(word, 0);
    decoded->m = low_register(word, 3);
    set_flags_outside_it_block(word, decoded);
}

static void compare_pair(const struct code_word *word, struct instruction *decoded)
{
    decoded->n = low_register(word, 0);
    decoded->m = low_register(word, 3);
}

static void shift_by_register(const struct code_word *word, struct instruction *decoded)
{
    static const uint8_t SHIFTS[] = {[2] = SHIFT_LSL, [3] = SHIFT_LSR, [4] = SHIFT_ASR, [7] = SHIFT_ROR};
    decoded->d = decoded->n = low_register(word, 0);
    decoded->m = low_register(word, 3);
    decoded->shift = SHIFTS[bits(word->bits, 8, 6)];
    decoded->sets_flags = !word->in_it_block;
}

/* RSBS Rd, Rn, #0 */
static void negate(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 0);
    decoded->n = low_register(word, 3);
    set_flags_outside_it_block(word, decoded);
}

static void multiply(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = decoded->m = low_register(word, 0);
    decoded->n = low_register(word, 3);
    decoded->sets_flags = !word->in_it_block;
}

static void invert(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 0);
    decoded->m = low_register(word, 3);
    set_flags_outside_it_block(word, decoded);
}

/* The PC as operand m is a number that the address decides, which another operation takes as its immediate. */
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
    decoded->m = register_at(word, 3);
    if (decoded->d == PC) decoded->operation = OP_ADD_PC;
    /* ADD PC, PC is UNPREDICTABLE (A7.7, ADD (register)). */
    fold_pc(word, decoded, decoded->d == PC ? OP_UNDEFINED : OP_ADD_I);
}

static void compare_high(const struct code_word *word, struct instruction *decoded)
{
    decoded->n = high_register(word);
    decoded->m = register_at(word, 3);
    /* UNPREDICTABLE with the PC (A7.7, CMP (register)). */
    refuse_pc(decoded, decoded->n);
    refuse_pc(decoded, decoded->m);
}

static void move_high(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = high_register(word);
    decoded->m = register_at(word, 3);
    if (decoded->d == PC) decoded->operation = OP_MOV_PC;
    fold_pc(word, decoded, decoded->d == PC ? OP_B : OP_MOV_I);
}

static void branch_register(const struct code_word *word, struct instruction *decoded)
{
    decoded->m = register_at(word, 3);
}

static void load_literal(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 8);
    decoded->n = PC;
    decoded->immediate = literal_base(word) + 4 * bits(word->bits, 7, 0);
}

static void access_register(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 0);
    decoded->n = low_register(word, 3);
    decoded->m = low_register(word, 6);
}

static void access_number(const struct code_word *word, struct instruction *decoded, uint32_t size)
{
    decoded->d = low_register(word, 0);
    decoded->n = low_register(word, 3);
    decoded->immediate = size * bits(word->bits, 10, 6);
}

static void access_word(const struct code_word *word, struct instruction *decoded) { access_number(word, decoded, 4); }
static void access_half(const struct code_word *word, struct instruction *decoded) { access_number(word, decoded, 2); }
static void access_byte(const struct code_word *word, struct instruction *decoded) { access_number(word, decoded, 1); }

static void access_stack(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 8);
    decoded->n = SP;
    decoded->immediate = 4 * bits(word->bits, 7, 0);
}

static void address_of_label(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 8);
    decoded->immediate = literal_base(word) + 4 * bits(word->bits, 7, 0);
}

static void move_stack_pointer(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = decoded->n = SP;
    decoded->immediate = 4 * bits(word->bits, 6, 0);
}

static void compare_and_branch(const struct code_word *word, struct instruction *decoded)
{
    decoded->n = low_register(word, 0);
    decoded->immediate = pc_operand(word) + (bits(word->bits, 7, 3) << 1 | bits(word->bits, 9, 9) << 6);
}

static void extend(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 0);
    decoded->m = low_register(word, 3);
    decoded->n = PC;
}

static void reverse(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = low_register(word, 0);
    decoded->m = low_register(word, 3);
}

/* An empty list is UNPREDICTABLE; Unicorn takes it as undefined. */
static void refuse_empty_list(struct instruction *decoded)
{
    if (decoded->words == 0) undefine(decoded);
}

static void push(const struct code_word *word, struct instruction *decoded)
{
    uint32_t mask = bits(word->bits, 7, 0) | bits(word->bits, 8, 8) << LR;
    set_register_list(decoded, SP, mask, MODE_WRITES_BACK | MODE_BEFORE);
    refuse_empty_list(decoded);
}

static void pop(const struct code_word *word, struct instruction *decoded)
{
    set_register_list(decoded, SP, bits(word->bits, 7, 0) | bits(word->bits, 8, 8) << PC, MODE_WRITES_BACK);
    refuse_empty_list(decoded);
}

static void store_multiple(const struct code_word *word, struct instruction *decoded)
{
    set_register_list(decoded, low_register(word, 8), bits(word->bits, 7, 0), MODE_WRITES_BACK);
    refuse_empty_list(decoded);
}

/* A base that is loaded is not written back (A7.7, LDM). */
static void load_multiple(const struct code_word *word, struct instruction *decoded)
{
    uint8_t base = low_register(word, 8);
    uint32_t mask = bits(word->bits, 7, 0);
    set_register_list(decoded, base, mask, is_set(mask, base) ? 0 : MODE_WRITES_BACK);
    refuse_empty_list(decoded);
}

static void change_masks(const struct code_word *word, struct instruction *decoded)
{
    decoded->amount = (uint8_t)bits(word->bits, 1, 0);
    decoded->immediate = bits(word->bits, 4, 4);
}

static void hint(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    decoded->row = ROW_system;
}

/* IT inside an IT block is UNPREDICTABLE. It begins a new block whatever the condition, as in Unicorn. */
static void if_then(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = bits(word->bits, 7, 0);
    decoded->condition = CONDITION_ALWAYS;
}

static void number(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = bits(word->bits, 7, 0);
}

/* BKPT is unconditional, inside an IT block too (A7.7, BKPT). */
static void breakpoint(const struct code_word *word, struct instruction *decoded)
{
    number(word, decoded);
    decoded->condition = CONDITION_ALWAYS;
}

/* A conditional branch in an IT block is UNPREDICTABLE; Unicorn takes it as undefined. */
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

/* A5.2.1: shift, add, subtract, move and compare with a number. LSL by 0 is MOV (register) T2. */
static const struct encoding BASIC[] = {
    {"LSL (immediate) T1", 0xF800, 0x0000, OP_MOV_X, shift_by_number, ARMV6M, 0},
    {"LSR (immediate) T1", 0xF800, 0x0800, OP_MOV_X, shift_by_number, ARMV6M, 0},
    {"ASR (immediate) T1", 0xF800, 0x1000, OP_MOV_X, shift_by_number, ARMV6M, 0},
    {"ADD (register) T1", 0xFE00, 0x1800, OP_ADD_R, three_registers, ARMV6M, 0},
    {"SUB (register) T1", 0xFE00, 0x1A00, OP_SUB_R, three_registers, ARMV6M, 0},
    {"ADD (immediate) T1", 0xFE00, 0x1C00, OP_ADD_I, two_registers_and_number, ARMV6M, 0},
    {"SUB (immediate) T1", 0xFE00, 0x1E00, OP_SUB_I, two_registers_and_number, ARMV6M, 0},
    {"MOV (immediate) T1", 0xF800, 0x2000, OP_MOV_I, move_number, ARMV6M, 0},
    {"CMP (immediate) T1", 0xF800, 0x2800, OP_CMP_IS, compare_number, ARMV6M, 0},
    {"ADD (immediate) T2", 0xF800, 0x3000, OP_ADD_I, register_and_number, ARMV6M, 0},
    {"SUB (immediate) T2", 0xF800, 0x3800, OP_SUB_I, register_and_number, ARMV6M, 0},
};

/* A5.2.2 */
static const struct encoding DATA[] = {
    {"AND (register) T1", 0xFFC0, 0x4000, OP_AND_R, register_pair, ARMV6M, 0},
    {"EOR (register) T1", 0xFFC0, 0x4040, OP_EOR_R, register_pair, ARMV6M, 0},
    {"LSL (register) T1", 0xFFC0, 0x4080, OP_SHIFT, shift_by_register, ARMV6M, 0},
    {"LSR (register) T1", 0xFFC0, 0x40C0, OP_SHIFT, shift_by_register, ARMV6M, 0},
    {"ASR (register) T1", 0xFFC0, 0x4100, OP_SHIFT, shift_by_register, ARMV6M, 0},
    {"ADC (register) T1", 0xFFC0, 0x4140, OP_ADC_R, register_pair, ARMV6M, 0},
    {"SBC (register) T1", 0xFFC0, 0x4180, OP_SBC_R, register_pair, ARMV6M, 0},
    {"ROR (register) T1", 0xFFC0, 0x41C0, OP_SHIFT, shift_by_register, ARMV6M, 0},
    {"TST (register) T1", 0xFFC0, 0x4200, OP_TST_RS, compare_pair, ARMV6M, 0},
    {"RSB (immediate) T1", 0xFFC0, 0x4240, OP_RSB_I, negate, ARMV6M, 0},
    {"CMP (register) T1", 0xFFC0, 0x4280, OP_CMP_RS, compare_pair, ARMV6M, 0},
    {"CMN (register) T1", 0xFFC0, 0x42C0, OP_CMN_RS, compare_pair, ARMV6M, 0},
    {"ORR (register) T1", 0xFFC0, 0x4300, OP_ORR_R, register_pair, ARMV6M, 0},
    {"MUL T1", 0xFFC0, 0x4340, OP_MUL, multiply, ARMV6M, 0},
    {"BIC (register) T1", 0xFFC0, 0x4380, OP_BIC_R, register_pair, ARMV6M, 0},
    {"MVN (register) T1", 0xFFC0, 0x43C0, OP_MVN_R, invert, ARMV6M, 0},
};

/* A5.2.3 */
static const struct encoding SPECIAL_DATA[] = {
    {"ADD (register) T2", 0xFF00, 0x4400, OP_ADD_R, add_high, ARMV6M, 0},
    {"CMP (register) T2", 0xFF00, 0x4500, OP_CMP_RS, compare_high, ARMV6M, 0},
    {"MOV (register) T1", 0xFF00, 0x4600, OP_MOV_R, move_high, ARMV6M, 0},
    {"BX T1", 0xFF87, 0x4700, OP_BX, branch_register, ARMV6M, 0},
    {"BLX (register) T1", 0xFF87, 0x4780, OP_BLX, branch_register, ARMV6M, 0},
};

/* A5.2.4, and the literal load */
static const struct encoding ACCESS[] = {
    {"LDR (literal) T1", 0xF800, 0x4800, OP_LDR_L, load_literal, ARMV6M, 0},
    {"STR (register) T1", 0xFE00, 0x5000, OP_STR_R, access_register, ARMV6M, 0},
    {"STRH (register) T1", 0xFE00, 0x5200, OP_STRH_R, access_register, ARMV6M, 0},
    {"STRB (register) T1", 0xFE00, 0x5400, OP_STRB_R, access_register, ARMV6M, 0},
    {"LDRSB (register) T1", 0xFE00, 0x5600, OP_LDRSB_R, access_register, ARMV6M, 0},
    {"LDR (register) T1", 0xFE00, 0x5800, OP_LDR_R, access_register, ARMV6M, 0},
    {"LDRH (register) T1", 0xFE00, 0x5A00, OP_LDRH_R, access_register, ARMV6M, 0},
    {"LDRB (register) T1", 0xFE00, 0x5C00, OP_LDRB_R, access_register, ARMV6M, 0},
    {"LDRSH (register) T1", 0xFE00, 0x5E00, OP_LDRSH_R, access_register, ARMV6M, 0},
    {"STR (immediate) T1", 0xF800, 0x6000, OP_STR_I, access_word, ARMV6M, 0},
    {"LDR (immediate) T1", 0xF800, 0x6800, OP_LDR_I, access_word, ARMV6M, 0},
    {"STRB (immediate) T1", 0xF800, 0x7000, OP_STRB_I, access_byte, ARMV6M, 0},
    {"LDRB (immediate) T1", 0xF800, 0x7800, OP_LDRB_I, access_byte, ARMV6M, 0},
    {"STRH (immediate) T1", 0xF800, 0x8000, OP_STRH_I, access_half, ARMV6M, 0},
    {"LDRH (immediate) T1", 0xF800, 0x8800, OP_LDRH_I, access_half, ARMV6M, 0},
    {"STR (immediate) T2", 0xF800, 0x9000, OP_STR_I, access_stack, ARMV6M, 0},
    {"LDR (immediate) T2", 0xF800, 0x9800, OP_LDR_I, access_stack, ARMV6M, 0},
};

/* A5.2.5, and the addresses relative to PC and SP */
static const struct encoding MISCELLANEOUS[] = {
    {"ADR T1", 0xF800, 0xA000, OP_MOV_I, address_of_label, ARMV6M, 0},
    {"ADD (SP plus immediate) T1", 0xF800, 0xA800, OP_ADD_I, access_stack, ARMV6M, 0},
    {"ADD (SP plus immediate) T2", 0xFF80, 0xB000, OP_ADD_I, move_stack_pointer, ARMV6M, 0},
    {"SUB (SP minus immediate) T1", 0xFF80, 0xB080, OP_SUB_I, move_stack_pointer, ARMV6M, 0},
    {"CBZ T1", 0xFD00, 0xB100, OP_CBZ, compare_and_branch, ARMV7M, 0},
    {"CBNZ T1", 0xFD00, 0xB900, OP_CBNZ, compare_and_branch, ARMV7M, 0},
    {"SXTH T1", 0xFFC0, 0xB200, OP_SXTAH, extend, ARMV6M, 0},
    {"SXTB T1", 0xFFC0, 0xB240, OP_SXTAB, extend, ARMV6M, 0},
    {"UXTH T1", 0xFFC0, 0xB280, OP_UXTAH, extend, ARMV6M, 0},
    {"UXTB T1", 0xFFC0, 0xB2C0, OP_UXTAB, extend, ARMV6M, 0},
    {"PUSH T1", 0xFE00, 0xB400, OP_STM, push, ARMV6M, 0},
    {"CPS T1", 0xFFEC, 0xB660, OP_CPS, change_masks, ARMV6M, 0},
    {"REV T1", 0xFFC0, 0xBA00, OP_REV, reverse, ARMV6M, 0},
    {"REV16 T1", 0xFFC0, 0xBA40, OP_REV16, reverse, ARMV6M, 0},
    {"REVSH T1", 0xFFC0, 0xBAC0, OP_REVSH, reverse, ARMV6M, 0},
    {"POP T1", 0xFE00, 0xBC00, OP_LDM, pop, ARMV6M, 0},
    {"BKPT T1", 0xFF00, 0xBE00, OP_BKPT, breakpoint, ARMV6M, 0},
    {"YIELD T1", 0xFFFF, 0xBF10, OP_YIELD, hint, ARMV6M, 0},
    {"WFE T1", 0xFFFF, 0xBF20, OP_WFE, hint, ARMV6M, 0},
    {"WFI T1", 0xFFFF, 0xBF30, OP_WFI, hint, ARMV6M, 0},
    {"SEV T1", 0xFFFF, 0xBF40, OP_SEV, hint, ARMV6M, 0},
    {"NOP T1, hints", 0xFF0F, 0xBF00, OP_NOP, hint, ARMV6M, 0},
    {"IT T1", 0xFF00, 0xBF00, OP_IT, if_then, ARMV7M, 0},
};

/* A5.2.6, multiple transfers and branches */
static const struct encoding BRANCHES[] = {
    {"STM T1", 0xF800, 0xC000, OP_STM, store_multiple, ARMV6M, 0},
    {"LDM T1", 0xF800, 0xC800, OP_LDM, load_multiple, ARMV6M, 0},
    {"UDF T1", 0xFF00, 0xDE00, OP_UNDEFINED, no_fields, ARMV6M, 0},
    {"SVC T1", 0xFF00, 0xDF00, OP_SVC, number, ARMV6M, 0},
    {"B T1", 0xF000, 0xD000, OP_B, branch_if, ARMV6M, 0},
    {"B T2", 0xF800, 0xE000, OP_B, branch, ARMV6M, 0},
};

/* The accesses have what the other groups leave. */
const struct encoding_group narrow_groups[] = {
    GROUP(0xC000, 0x0000, BASIC),
    GROUP(0xFC00, 0x4000, DATA),
    GROUP(0xFC00, 0x4400, SPECIAL_DATA),
    GROUP(0xE000, 0xA000, MISCELLANEOUS),
    GROUP(0xC000, 0xC000, BRANCHES),
    GROUP(0x0000, 0x0000, ACCESS),
    {0, 0, NULL, 0},
};
