/* Encodings of four bytes that access memory with core registers (DDI 0403E, A5.3.5 to A5.3.10). */

#include "decode.h"

#include <stddef.h>

enum { D = 12, N = 16, M = 0 }; /* where the registers stand */

/* Stores relative to the PC are undefined, and transfers of the PC are but for LDR UNPREDICTABLE. */
static bool may_load_pc(const struct instruction *decoded)
{
    return decoded->operation >= OP_LDR_I && decoded->operation < OP_LDR_I + ACCESS_FORM_COUNT;
}

static void take_registers(const struct code_word *word, struct instruction *decoded)
{
    decoded->d = register_at(word, D);
    decoded->n = register_at(word, N);
    if (!may_load_pc(decoded)) refuse_pc(decoded, decoded->d);
    refuse_pc(decoded, decoded->n);
}

static void offset_12_bits(const struct code_word *word, struct instruction *decoded)
{
    take_registers(word, decoded);
    decoded->immediate = bits(word->bits, 11, 0);
}

static void offset_below(const struct code_word *word, struct instruction *decoded)
{
    take_registers(word, decoded);
    decoded->immediate = 0 - bits(word->bits, 7, 0);
}

/* LDRT, STRT and the like: nothing is protected from unprivileged code here, so they are plain accesses. */
static void unprivileged(const struct code_word *word, struct instruction *decoded)
{
    take_registers(word, decoded);
    decoded->immediate = bits(word->bits, 7, 0);
    refuse_pc(decoded, decoded->d);
}

static void writes_back(const struct code_word *word, struct instruction *decoded)
{
    uint32_t offset = bits(word->bits, 7, 0);
    bool upward = is_set(word->bits, 9), before = is_set(word->bits, 10);
    take_registers(word, decoded);
    decoded->immediate = upward ? offset : 0 - offset;
    decoded->mode = before ? MODE_WRITES_BACK : MODE_WRITES_BACK | MODE_POST;
}

static void offset_register(const struct code_word *word, struct instruction *decoded)
{
    take_registers(word, decoded);
    decoded->m = register_at(word, M);
    decoded->amount = (uint8_t)bits(word->bits, 5, 4);
    refuse_pc(decoded, decoded->m);
}

static void literal(const struct code_word *word, struct instruction *decoded)
{
    uint32_t offset = bits(word->bits, 11, 0), base = literal_base(word);
    decoded->d = register_at(word, D);
    decoded->n = PC;
    decoded->immediate = is_set(word->bits, 23) ? base + offset : base - offset;
    if (!may_load_pc(decoded)) refuse_pc(decoded, decoded->d);
}

/* Hints of addresses that will be accessed soon. They do nothing but take part in the cycle model. */
static void hint_address(const struct code_word *word, struct instruction *decoded)
{
    decoded->address_registers = (uint16_t)((1u << register_at(word, N)) & 0x7FFFu);
}

static void hint_address_register(const struct code_word *word, struct instruction *decoded)
{
    hint_address(word, decoded);
    decoded->address_registers |= (uint16_t)((1u << register_at(word, M)) & 0x7FFFu);
}

/* Two words, with the offset in words (A5.3.6) */
static void take_pair(const struct code_word *word, struct instruction *decoded)
{
    uint32_t offset = 4 * bits(word->bits, 7, 0);
    decoded->d = register_at(word, D);
    decoded->a = register_at(word, 8);
    decoded->n = register_at(word, N);
    decoded->immediate = is_set(word->bits, 23) ? offset : 0 - offset;
    decoded->words = 2;
    refuse_pc(decoded, decoded->d);
    refuse_pc(decoded, decoded->a);
}

static void pair(const struct code_word *word, struct instruction *decoded)
{
    bool before = is_set(word->bits, 24), writes_base = is_set(word->bits, 21);
    take_pair(word, decoded);
    decoded->mode = (uint8_t)((writes_base ? MODE_WRITES_BACK : 0) | (before ? 0 : MODE_POST));
    refuse_pc(decoded, decoded->n);
}

static void pair_literal(const struct code_word *word, struct instruction *decoded)
{
    take_pair(word, decoded);
    decoded->immediate += literal_base(word);
}

/* A load into the SP is UNPREDICTABLE; Unicorn takes it as undefined. */
static void load_exclusive_part(const struct code_word *word, struct instruction *decoded)
{
    take_registers(word, decoded);
    if (decoded->d == SP) undefine(decoded);
}

static void load_exclusive(const struct code_word *word, struct instruction *decoded)
{
    load_exclusive_part(word, decoded);
    decoded->immediate = 4 * bits(word->bits, 7, 0);
}

/* A result in a register that the store uses, and the SP as result or value, are UNPREDICTABLE; Unicorn takes them as
 * undefined. */
static void take_exclusive_store(const struct code_word *word, struct instruction *decoded, uint8_t result)
{
    decoded->d = result;
    decoded->a = register_at(word, D);
    decoded->n = register_at(word, N);
    refuse_pc(decoded, decoded->d);
    refuse_pc(decoded, decoded->a);
    refuse_pc(decoded, decoded->n);
    if (decoded->d == decoded->n || decoded->d == decoded->a) undefine(decoded);
    if (decoded->d == SP || decoded->a == SP) undefine(decoded);
}

static void store_exclusive(const struct code_word *word, struct instruction *decoded)
{
    take_exclusive_store(word, decoded, register_at(word, 8));
    decoded->immediate = 4 * bits(word->bits, 7, 0);
}

static void store_exclusive_part(const struct code_word *word, struct instruction *decoded)
{
    take_exclusive_store(word, decoded, register_at(word, 0));
}

static void table_branch(const struct code_word *word, struct instruction *decoded)
{
    decoded->n = register_at(word, N);
    decoded->m = register_at(word, M);
    decoded->immediate = pc_operand(word);
    refuse_pc(decoded, decoded->m);
}

/* Multiple transfers (A5.3.5). A list of one register or none, and one with the base that is written back, are
 * UNPREDICTABLE; Unicorn takes them as undefined. */
static void multiple(const struct code_word *word, struct instruction *decoded)
{
    bool upward = is_set(word->bits, 23), writes_base = is_set(word->bits, 21);
    uint8_t mode = (uint8_t)((upward ? 0 : MODE_BEFORE) | (writes_base ? MODE_WRITES_BACK : 0));
    set_register_list(decoded, register_at(word, N), bits(word->bits, 15, 0), mode);
    refuse_pc(decoded, decoded->n);
    if (decoded->words < 2 || (writes_base && is_set(decoded->immediate, decoded->n))) undefine(decoded);
}

/* A store of the PC is UNPREDICTABLE. */
static void store_multiple(const struct code_word *word, struct instruction *decoded)
{
    multiple(word, decoded);
    if (is_set(decoded->immediate, PC)) undefine(decoded);
}

/* Hints have the places of loads into the PC of less than a word (A5.3.8, A5.3.9). */
#define HINT_ROWS(NAME, VALUE) \
    {NAME " (literal) T1", 0xFF7FF000, VALUE | 0x000FF000u, OP_NOP, hint_address, ARMV7M, 0}, \
    {NAME " (immediate) T1", 0xFFF0F000, VALUE | 0x0080F000u, OP_NOP, hint_address, ARMV7M, 0}, \
    {NAME " (immediate) T2", 0xFFF0FF00, VALUE | 0x0000FC00u, OP_NOP, hint_address, ARMV7M, 0}, \
    {NAME " (register) T1", 0xFFF0FFC0, VALUE | 0x0000F000u, OP_NOP, hint_address_register, ARMV7M, 0}

#define ACCESS_ROWS(NAME, VALUE) \
    {#NAME " (immediate), 12 bits", 0xFFF00000, VALUE | 0x00800000u, OP_##NAME##_I, offset_12_bits, ARMV7M, 0}, \
    {#NAME " (immediate), 8 bits", 0xFFF00F00, VALUE | 0x00000C00u, OP_##NAME##_I, offset_below, ARMV7M, 0}, \
    {#NAME "T T1", 0xFFF00F00, VALUE | 0x00000E00u, OP_##NAME##_I, unprivileged, ARMV7M, 0}, \
    {#NAME " (immediate), written back", 0xFFF00900, VALUE | 0x00000900u, OP_##NAME##_W, writes_back, ARMV7M, 0}, \
    {#NAME " (register) T2", 0xFFF00FC0, VALUE, OP_##NAME##_R, offset_register, ARMV7M, 0}

#define LOAD_ROWS(NAME, VALUE) \
    {#NAME " (literal)", 0xFF7F0000, VALUE | 0x000F0000u, OP_##NAME##_L, literal, ARMV7M, 0}, ACCESS_ROWS(NAME, VALUE)

/* A5.3.10 */
static const struct encoding STORES[] = {
    ACCESS_ROWS(STRB, 0xF8000000u), ACCESS_ROWS(STRH, 0xF8200000u), ACCESS_ROWS(STR, 0xF8400000u),
};

/* A5.3.7 to A5.3.9 */
static const struct encoding LOADS[] = {
    HINT_ROWS("PLD", 0xF8100000u), LOAD_ROWS(LDRB, 0xF8100000u),
    HINT_ROWS("Hint without a name", 0xF8300000u), LOAD_ROWS(LDRH, 0xF8300000u),
    LOAD_ROWS(LDR, 0xF8500000u),
    HINT_ROWS("PLI", 0xF9100000u), LOAD_ROWS(LDRSB, 0xF9100000u),
    HINT_ROWS("Signed hint without a name", 0xF9300000u), LOAD_ROWS(LDRSH, 0xF9300000u),
};

/* A5.3.5 */
static const struct encoding MULTIPLES[] = {
    {"STM T2", 0xFFD00000, 0xE8800000, OP_STM, store_multiple, ARMV7M, 0},
    {"LDM T2", 0xFFD00000, 0xE8900000, OP_LDM, multiple, ARMV7M, 0},
    {"STMDB T1", 0xFFD00000, 0xE9000000, OP_STM, store_multiple, ARMV7M, 0},
    {"LDMDB T1", 0xFFD00000, 0xE9100000, OP_LDM, multiple, ARMV7M, 0},
};

/* A5.3.6. The pairs have the places that bits P and W, both zero, leave to exclusive accesses and table branches. */
static const struct encoding PAIRS[] = {
    {"STREX T1", 0xFFF00000, 0xE8400000, OP_STREX, store_exclusive, ARMV7M, 0},
    {"LDREX T1", 0xFFF00F00, 0xE8500F00, OP_LDREX, load_exclusive, ARMV7M, 0},
    {"STREXB T1", 0xFFF00FF0, 0xE8C00F40, OP_STREXB, store_exclusive_part, ARMV7M, 0},
    {"STREXH T1", 0xFFF00FF0, 0xE8C00F50, OP_STREXH, store_exclusive_part, ARMV7M, 0},
    {"TBB T1", 0xFFF0FFF0, 0xE8D0F000, OP_TBB, table_branch, ARMV7M, 0},
    {"TBH T1", 0xFFF0FFF0, 0xE8D0F010, OP_TBH, table_branch, ARMV7M, 0},
    {"LDREXB T1", 0xFFF00FFF, 0xE8D00F4F, OP_LDREXB, load_exclusive_part, ARMV7M, 0},
    {"LDREXH T1", 0xFFF00FFF, 0xE8D00F5F, OP_LDREXH, load_exclusive_part, ARMV7M, 0},
    {"Exclusive accesses that ARMv7-M has not", 0xFF600000, 0xE8400000, OP_UNDEFINED, no_fields, ARMV7M, 0},
    {"LDRD (literal) T1", 0xFF7F0000, 0xE95F0000, OP_LDRD, pair_literal, ARMV7M, 0},
    {"LDRD (immediate) T1", 0xFE500000, 0xE8500000, OP_LDRD, pair, ARMV7M, 0},
    {"STRD (immediate) T1", 0xFE500000, 0xE8400000, OP_STRD, pair, ARMV7M, 0},
};

const struct encoding_group access_groups[] = {
    GROUP(0xFE400000, 0xE8000000, MULTIPLES),
    GROUP(0xFE400000, 0xE8400000, PAIRS),
    GROUP(0xFF100000, 0xF8000000, STORES),
    GROUP(0xFE100000, 0xF8100000, LOADS),
    {0, 0, NULL, 0},
};
