/* Encodings of four bytes that access memory with core registers (DDI 0403E, A5.3.5 to A5.3.10). */

#include "decode.h"

#include <stddef.h>

static void offset_below(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    decoded->immediate = 0 - decoded->immediate;
}

static void writes_back(const struct code_word *word, struct instruction *decoded)
{
    bool upward = is_set(word->bits, 9), before = is_set(word->bits, 10);
    if (!upward) decoded->immediate = 0 - decoded->immediate;
    decoded->mode = before ? MODE_WRITES_BACK : MODE_WRITES_BACK | MODE_POST;
}

static void literal(const struct code_word *word, struct instruction *decoded)
{
    uint32_t base = literal_base(word);
    decoded->immediate = is_set(word->bits, 23) ? base + decoded->immediate : base - decoded->immediate;
}

/* Prefetch hints. They have no effect except in the cycle model. */
static void hint_address(const struct code_word *word, struct instruction *decoded)
{
    decoded->address_registers = (uint16_t)((1u << register_at(word, 16)) & 0x7FFFu);
}

static void hint_address_register(const struct code_word *word, struct instruction *decoded)
{
    hint_address(word, decoded);
    decoded->address_registers |= (uint16_t)((1u << register_at(word, 0)) & 0x7FFFu);
}

/* Transfers of two words, with the offset in words (A5.3.6). */
static void take_pair(const struct code_word *word, struct instruction *decoded)
{
    decoded->words = 2;
    if (!is_set(word->bits, 23)) decoded->immediate = 0 - decoded->immediate;
}

static void pair(const struct code_word *word, struct instruction *decoded)
{
    bool before = is_set(word->bits, 24), writes_base = is_set(word->bits, 21);
    take_pair(word, decoded);
    decoded->mode = (uint8_t)((writes_base ? MODE_WRITES_BACK : 0) | (before ? 0 : MODE_POST));
}

static void pair_literal(const struct code_word *word, struct instruction *decoded)
{
    take_pair(word, decoded);
    decoded->immediate += literal_base(word);
}

/* A load into the SP is UNPREDICTABLE; it is undefined as in Unicorn. */
static void load_exclusive(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    if (decoded->d == SP) undefine(decoded);
}

/* A result in a register that the store uses, and the SP as result or value, are UNPREDICTABLE; they are undefined as
 * in Unicorn. */
static void store_exclusive(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    if (decoded->d == decoded->n || decoded->d == decoded->a) undefine(decoded);
    if (decoded->d == SP || decoded->a == SP) undefine(decoded);
}

static void table_branch(const struct code_word *word, struct instruction *decoded)
{
    decoded->immediate = pc_operand(word);
}

/* Multiple transfers (A5.3.5). A list of one register or none, and a list with the base that is written back, are
 * UNPREDICTABLE; they are undefined as in Unicorn. */
static void multiple(const struct code_word *word, struct instruction *decoded)
{
    bool upward = is_set(word->bits, 23), writes_base = is_set(word->bits, 21);
    transfer_list(decoded, (uint8_t)((upward ? 0 : MODE_BEFORE) | (writes_base ? MODE_WRITES_BACK : 0)));
    if (decoded->words < 2 || (writes_base && is_set(decoded->immediate, decoded->n))) undefine(decoded);
}

/* A store of the PC is UNPREDICTABLE. */
static void store_multiple(const struct code_word *word, struct instruction *decoded)
{
    multiple(word, decoded);
    if (is_set(decoded->immediate, PC)) undefine(decoded);
}

/* Hints have the encodings of narrow loads into the PC (A5.3.8, A5.3.9). */
#define HINT_ROWS(NAME, VALUE) \
    {NAME " (literal) T1", 0xFF7FF000, VALUE | 0x000FF000u, OP_NOP, .extract = hint_address}, \
    {NAME " (immediate) T1", 0xFFF0F000, VALUE | 0x0080F000u, OP_NOP, .extract = hint_address}, \
    {NAME " (immediate) T2", 0xFFF0FF00, VALUE | 0x0000FC00u, OP_NOP, .extract = hint_address}, \
    {NAME " (register) T1", 0xFFF0FFC0, VALUE | 0x0000F000u, OP_NOP, .extract = hint_address_register}

/* MAY says whether the transferred register may be the PC: ANY or NOT_PC. Stores relative to the PC are
 * undefined, and transfers of the PC are UNPREDICTABLE except for LDR. LDRT, STRT and the like are plain accesses,
 * because no memory is protected from unprivileged code. */
#define N NOT_PC(n, 16)
#define ACCESS_ROWS(NAME, VALUE, MAY) \
    {#NAME " (immediate), 12 bits", 0xFFF00000, VALUE | 0x00800000u, OP_##NAME##_I, MAY(d, 12), N, NUMBER(0, 12, 0)}, \
    {#NAME " (immediate), 8 bits", 0xFFF00F00, VALUE | 0x00000C00u, OP_##NAME##_I, MAY(d, 12), N, NUMBER(0, 8, 0), \
     .extract = offset_below}, \
    {#NAME "T T1", 0xFFF00F00, VALUE | 0x00000E00u, OP_##NAME##_I, NOT_PC(d, 12), N, NUMBER(0, 8, 0)}, \
    {#NAME " (immediate), written back", 0xFFF00900, VALUE | 0x00000900u, OP_##NAME##_W, MAY(d, 12), N, \
     NUMBER(0, 8, 0), .extract = writes_back}, \
    {#NAME " (register) T2", 0xFFF00FC0, VALUE, OP_##NAME##_R, MAY(d, 12), N, NOT_PC(m, 0), AMOUNT(4, 2)}

#define LOAD_ROWS(NAME, VALUE, MAY) \
    {#NAME " (literal)", 0xFF7F0000, VALUE | 0x000F0000u, OP_##NAME##_L, MAY(d, 12), FIXED(n, PC), NUMBER(0, 12, 0), \
     .extract = literal}, ACCESS_ROWS(NAME, VALUE, MAY)

#define D NOT_PC(d, 12)

/* A5.3.10 */
static const struct encoding STORES[] = {
    ACCESS_ROWS(STRB, 0xF8000000u, NOT_PC), ACCESS_ROWS(STRH, 0xF8200000u, NOT_PC),
    ACCESS_ROWS(STR, 0xF8400000u, NOT_PC),
};

/* A5.3.7 to A5.3.9 */
static const struct encoding LOADS[] = {
    HINT_ROWS("PLD", 0xF8100000u), LOAD_ROWS(LDRB, 0xF8100000u, NOT_PC),
    HINT_ROWS("Hint without a name", 0xF8300000u), LOAD_ROWS(LDRH, 0xF8300000u, NOT_PC),
    LOAD_ROWS(LDR, 0xF8500000u, ANY),
    HINT_ROWS("PLI", 0xF9100000u), LOAD_ROWS(LDRSB, 0xF9100000u, NOT_PC),
    HINT_ROWS("Signed hint without a name", 0xF9300000u), LOAD_ROWS(LDRSH, 0xF9300000u, NOT_PC),
};

/* A5.3.5 */
static const struct encoding MULTIPLES[] = {
    {"STM T2", 0xFFD00000, 0xE8800000, OP_STM, N, NUMBER(0, 16, 0), .extract = store_multiple},
    {"LDM T2", 0xFFD00000, 0xE8900000, OP_LDM, N, NUMBER(0, 16, 0), .extract = multiple},
    {"STMDB T1", 0xFFD00000, 0xE9000000, OP_STM, N, NUMBER(0, 16, 0), .extract = store_multiple},
    {"LDMDB T1", 0xFFD00000, 0xE9100000, OP_LDM, N, NUMBER(0, 16, 0), .extract = multiple},
};

/* A5.3.6. If bits P and W are both zero, the encodings are exclusive accesses and table branches instead of pairs. */
#define STORED NOT_PC(a, 12), N, .extract = store_exclusive
#define PAIR D, NOT_PC(a, 8), NUMBER(0, 8, 2)
static const struct encoding PAIRS[] = {
    {"STREX T1", 0xFFF00000, 0xE8400000, OP_STREX, NOT_PC(d, 8), NUMBER(0, 8, 2), STORED},
    {"LDREX T1", 0xFFF00F00, 0xE8500F00, OP_LDREX, D, N, NUMBER(0, 8, 2), .extract = load_exclusive},
    {"STREXB T1", 0xFFF00FF0, 0xE8C00F40, OP_STREXB, NOT_PC(d, 0), STORED},
    {"STREXH T1", 0xFFF00FF0, 0xE8C00F50, OP_STREXH, NOT_PC(d, 0), STORED},
    {"TBB T1", 0xFFF0FFF0, 0xE8D0F000, OP_TBB, ANY(n, 16), NOT_PC(m, 0), .extract = table_branch},
    {"TBH T1", 0xFFF0FFF0, 0xE8D0F010, OP_TBH, ANY(n, 16), NOT_PC(m, 0), .extract = table_branch},
    {"LDREXB T1", 0xFFF00FFF, 0xE8D00F4F, OP_LDREXB, D, N, .extract = load_exclusive},
    {"LDREXH T1", 0xFFF00FFF, 0xE8D00F5F, OP_LDREXH, D, N, .extract = load_exclusive},
    {"Exclusive accesses that ARMv7-M has not", 0xFF600000, 0xE8400000, OP_UNDEFINED, .extract = NULL},
    {"LDRD (literal) T1", 0xFF7F0000, 0xE95F0000, OP_LDRD, PAIR, ANY(n, 16), .extract = pair_literal},
    {"LDRD (immediate) T1", 0xFE500000, 0xE8500000, OP_LDRD, PAIR, N, .extract = pair},
    {"STRD (immediate) T1", 0xFE500000, 0xE8400000, OP_STRD, PAIR, N, .extract = pair},
};

const struct encoding_group access_groups[] = {
    GROUP(0xFE400000, 0xE8000000, MULTIPLES),
    GROUP(0xFE400000, 0xE8400000, PAIRS),
    GROUP(0xFF100000, 0xF8000000, STORES),
    GROUP(0xFE100000, 0xF8100000, LOADS),
    {0, 0, NULL, 0},
};
