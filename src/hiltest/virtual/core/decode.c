/* Decoding: finding the encoding of an instruction, and the fields that all encodings have in common. */

#include "decode.h"

#include <string.h>

enum { CARRY_STAYS = 2, CONDITION_NEVER = 15 };

static const struct encoding_group *const NARROW[] = {narrow_groups, NULL};
static const struct encoding_group *const WIDE[] = {data_groups, access_groups, float_groups, NULL};

/* Return the encoding of an instruction among groups; NULL if no row matches. */
static const struct encoding *find_encoding(const struct encoding_group *const *lists, uint32_t bits)
{
    for (; *lists; lists++) {
        for (const struct encoding_group *group = *lists; group->count; group++) {
            if ((bits & group->mask) != group->value) continue;
            for (int i = 0; i < group->count; i++) {
                if ((bits & group->rows[i].mask) == group->rows[i].value) return &group->rows[i];
            }
            return NULL;
        }
    }
    return NULL;
}

/* Condition of an instruction in an IT block. ITSTATE may hold condition 15, which is UNPREDICTABLE (A7.7, IT);
 * as in Unicorn, it means "always". */
static uint8_t block_condition(uint8_t it_state)
{
    uint8_t condition = it_state >> 4;
    return condition == CONDITION_NEVER ? CONDITION_ALWAYS : condition;
}

/* Set the fields of an instruction without effect, in an IT block or not. */
static void clear(struct instruction *decoded, uint8_t size, uint8_t it_state)
{
    bool in_it_block = it_state & 15;
    memset(decoded, 0, sizeof *decoded);
    decoded->operation = OP_UNDEFINED;
    decoded->size = size;
    decoded->condition = in_it_block ? block_condition(it_state) : CONDITION_ALWAYS;
    decoded->carry = CARRY_STAYS;
    decoded->row = ROW_data;
    decoded->in_it_block = in_it_block;
}

/* Read the number of a register from its field. False if the number is not allowed. */
static bool take_register(const struct code_word *word, struct register_field field, uint8_t *number)
{
    const unsigned low = field.low;
    switch (field.kind) {
    case REGISTER_ABSENT: return true;
    case REGISTER_LOW: *number = (uint8_t)bits(word->bits, low + 2, low); return true;
    case REGISTER_SINGLE: *number = single_at(word, low); return true;
    case REGISTER_FIXED: *number = field.low; return true;
    default: *number = register_at(word, low); return field.kind == REGISTER_ANY || *number != PC;
    }
}

static uint32_t take_number(const struct code_word *word, struct number_field field)
{
    return field.width ? bits(word->bits, field.low + field.width - 1u, field.low) << field.shift : 0;
}

static void take_fields(const struct code_word *word, const struct encoding *encoding, struct instruction *decoded)
{
    bool is_defined = take_register(word, encoding->d, &decoded->d) & take_register(word, encoding->n, &decoded->n)
        & take_register(word, encoding->m, &decoded->m) & take_register(word, encoding->a, &decoded->a);
    decoded->operation = encoding->operation;
    decoded->immediate = take_number(word, encoding->immediate);
    decoded->amount = (uint8_t)take_number(word, encoding->amount);
    if (encoding->extract) encoding->extract(word, decoded);
    if (!is_defined) undefine(decoded);
}

static bool has_baseline(const struct encoding *encoding, uint8_t size)
{
    switch (encoding->operation) {
    case OP_CBZ: case OP_CBNZ: case OP_IT: return false;
    default: return size == 2 || encoding->is_baseline;
    }
}

void decode_instruction(
    uint32_t address, uint16_t first, uint16_t second, uint8_t it_state, bool baseline, struct instruction *decoded)
{
    uint8_t size = instruction_size(first);
    uint32_t bits = size == 2 ? first : (uint32_t)first << 16 | second;
    struct code_word word = {bits, address, it_state & 15};
    const struct encoding *encoding = find_encoding(size == 2 ? NARROW : WIDE, bits);

    clear(decoded, size, it_state);
    if (!encoding || (baseline && !has_baseline(encoding, size))) return;
    take_fields(&word, encoding, decoded);
    if (decoded->operation == OP_UNDEFINED || decoded->operation == OP_NO_COPROCESSOR) {
        uint16_t operation = decoded->operation;
        clear(decoded, size, it_state);
        decoded->operation = operation;
        return;
    }
    if (decoded->operation >= OP_AND_I && decoded->operation < OP_LDR_I) decoded->sets_flags = has_flag_form(decoded);
    describe_costs(decoded);
}

void set_shift(struct instruction *decoded, uint32_t type, uint32_t amount)
{
    decoded->shift = (uint8_t)type;
    decoded->amount = (uint8_t)amount;
    if (amount) return;
    if (type == SHIFT_LSR || type == SHIFT_ASR) decoded->amount = 32;
    if (type == SHIFT_ROR) {
        decoded->shift = SHIFT_RRX;
        decoded->amount = 1;
    }
}

/* An empty list is UNPREDICTABLE; it is undefined as in Unicorn. */
void transfer_list(struct instruction *decoded, uint8_t mode)
{
    decoded->mode = mode;
    decoded->words = count_bits(decoded->immediate);
    if (!decoded->words) undefine(decoded);
}

void hint(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    decoded->row = ROW_system;
}
