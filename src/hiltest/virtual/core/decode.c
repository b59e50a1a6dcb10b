/* From halfwords to an instruction: which encoding it is, and what all encodings have in common. */

#include "decode.h"

#include <string.h>

enum { CARRY_STAYS = 2, CONDITION_NEVER = 15 };

static const struct encoding_group *const NARROW[] = {narrow_groups, NULL};
static const struct encoding_group *const WIDE[] = {data_groups, access_groups, float_groups, NULL};

/* Find the encoding of an instruction among groups; NULL if no row matches. */
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
 * it is taken as "always", as Unicorn takes it. */
static uint8_t block_condition(uint8_t it_state)
{
    uint8_t condition = it_state >> 4;
    return condition == CONDITION_NEVER ? CONDITION_ALWAYS : condition;
}

/* Set the fields of an instruction that does nothing, in an IT block or not. */
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

void decode_instruction(
    uint32_t address, uint16_t first, uint16_t second, uint8_t it_state, bool baseline, struct instruction *decoded)
{
    uint8_t size = instruction_size(first);
    uint32_t bits = size == 2 ? first : (uint32_t)first << 16 | second;
    struct code_word word = {bits, address, it_state & 15};
    const struct encoding *encoding = find_encoding(size == 2 ? NARROW : WIDE, bits);

    clear(decoded, size, it_state);
    if (!encoding || (baseline && encoding->profile != ARMV6M)) return;
    decoded->operation = encoding->operation;
    encoding->extract(&word, decoded);
    if (decoded->operation == OP_UNDEFINED || decoded->operation == OP_NO_COPROCESSOR) {
        uint16_t operation = decoded->operation;
        clear(decoded, size, it_state);
        decoded->operation = operation;
        return;
    }
    if (decoded->operation >= OP_AND_I && decoded->operation < OP_LDR_I) {
        decoded->sets_flags = (decoded->operation - OP_AND_I) % 2 == FORM_SETS_FLAGS;
    }
    describe_costs(decoded);
}

/* Walk all groups: return the row of an index and its size, or count the rows if the index is past the last one. */
static const struct encoding *walk(int index, int *count, uint8_t *size)
{
    const struct encoding_group *const lists[] = {narrow_groups, data_groups, access_groups, float_groups};
    *count = 0;
    for (int list = 0; list < 4; list++) {
        for (const struct encoding_group *group = lists[list]; group->count; group++) {
            *size = list == 0 ? 2 : 4;
            if (index < *count + group->count) return &group->rows[index - *count];
            *count += group->count;
        }
    }
    return NULL;
}

int encoding_count(void)
{
    int count;
    uint8_t size;
    walk(INT32_MAX, &count, &size);
    return count;
}

struct encoding encoding_at(int index)
{
    int count;
    uint8_t size;
    const struct encoding *row = walk(index, &count, &size);
    struct encoding encoding = {0};
    if (row) {
        encoding = *row;
        encoding.size = size;
    }
    return encoding;
}

void no_fields(const struct code_word *word, struct instruction *decoded)
{
    (void)word;
    (void)decoded;
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

void set_register_list(struct instruction *decoded, uint8_t base, uint32_t mask, uint8_t mode)
{
    decoded->n = base;
    decoded->immediate = mask;
    decoded->mode = mode;
    decoded->words = count_bits(mask);
}

#define NAME(OPERATION) [OP_##OPERATION] = #OPERATION,
#define DATA_NAMES(X) NAME(X##_I) NAME(X##_IS) NAME(X##_R) NAME(X##_RS) NAME(X##_X) NAME(X##_XS)
#define ACCESS_NAMES(X) NAME(X##_I) NAME(X##_R) NAME(X##_L) NAME(X##_W)
#define PARALLEL_NAMES(X) NAME(X##ADD16) NAME(X##ASX) NAME(X##SAX) NAME(X##SUB16) NAME(X##ADD8) NAME(X##SUB8)

static const char *const OPERATION_NAMES[OPERATIONS] = {
    NAME(UNDEFINED) NAME(NO_COPROCESSOR)
    DATA_OPERATIONS(DATA_NAMES)
    ACCESS_OPERATIONS(ACCESS_NAMES)
    PARALLEL_KINDS(PARALLEL_NAMES)
    NAME(SHIFT) NAME(MOVT) NAME(MOV_PC) NAME(ADD_PC) NAME(LDRD) NAME(STRD) NAME(LDM) NAME(STM)
    NAME(LDREX) NAME(LDREXB) NAME(LDREXH) NAME(STREX) NAME(STREXB) NAME(STREXH) NAME(CLREX) NAME(TBB) NAME(TBH)
    NAME(MUL) NAME(MLA) NAME(MLS) NAME(UMULL) NAME(SMULL) NAME(UMLAL) NAME(SMLAL) NAME(UMAAL) NAME(SDIV) NAME(UDIV)
    NAME(SMLA_HALVES) NAME(SMLAW) NAME(SMLAL_HALVES) NAME(SMLAD) NAME(SMLSD) NAME(SMLALD) NAME(SMLSLD)
    NAME(SMMLA) NAME(SMMLS) NAME(USADA8) NAME(BFI) NAME(BFC) NAME(SBFX) NAME(UBFX)
    NAME(SXTAB) NAME(SXTAH) NAME(UXTAB) NAME(UXTAH) NAME(SXTAB16) NAME(UXTAB16)
    NAME(CLZ) NAME(RBIT) NAME(REV) NAME(REV16) NAME(REVSH) NAME(SSAT) NAME(USAT) NAME(SSAT16) NAME(USAT16)
    NAME(QADD) NAME(QSUB) NAME(QDADD) NAME(QDSUB) NAME(SEL) NAME(PKHBT) NAME(PKHTB)
    NAME(B) NAME(BL) NAME(BX) NAME(BLX) NAME(CBZ) NAME(CBNZ) NAME(IT) NAME(SVC) NAME(BKPT)
    NAME(NOP) NAME(YIELD) NAME(WFE) NAME(WFI) NAME(SEV) NAME(DMB) NAME(DSB) NAME(ISB) NAME(CPS) NAME(MRS) NAME(MSR)
    NAME(VADD) NAME(VSUB) NAME(VMUL) NAME(VNMUL) NAME(VDIV) NAME(VMLA) NAME(VMLS) NAME(VNMLA) NAME(VNMLS)
    NAME(VFMA) NAME(VFMS) NAME(VFNMA) NAME(VFNMS) NAME(VABS) NAME(VNEG) NAME(VSQRT) NAME(VMOV) NAME(VMOV_I)
    NAME(VCMP) NAME(VCMP_ZERO) NAME(VCVT_TO_INTEGER) NAME(VCVT_FROM_INTEGER) NAME(VCVT_TO_FIXED)
    NAME(VCVT_FROM_FIXED) NAME(VCVT_TO_HALF) NAME(VCVT_FROM_HALF) NAME(VMOV_TO_CORE) NAME(VMOV_FROM_CORE)
    NAME(VMOV_PAIR_TO_CORE) NAME(VMOV_PAIR_FROM_CORE) NAME(VMRS) NAME(VMSR) NAME(VLDR) NAME(VSTR) NAME(VLDM) NAME(VSTM)
};

const char *operation_name(uint16_t operation) { return operation < OPERATIONS ? OPERATION_NAMES[operation] : ""; }
