/* A decoded Thumb instruction: its operation, and its properties for the cycle model.
 *
 * References are to the ARMv7-M Architecture Reference Manual, DDI 0403E.
 */
#ifndef HILTEST_INSTRUCTION_H
#define HILTEST_INSTRUCTION_H

#include <stdbool.h>
#include <stdint.h>

/* Data processing. Each operation has six forms, in this order; see `DATA_FORMS`.
 *   _I   immediate                      _IS   the same, sets the flags
 *   _R   register, not shifted          _RS
 *   _X   register, shifted by a number  _XS
 * d = n OP operand; the operand is `immediate`, r[m], or r[m] shifted by `shift` and `amount`. TST, TEQ, CMP and CMN
 * have no destination and only flag-setting forms. MOV and MVN do not read n.
 */
#define DATA_OPERATIONS(X) \
    X(AND) X(BIC) X(ORR) X(ORN) X(EOR) X(ADD) X(ADC) X(SUB) X(SBC) X(RSB) X(MOV) X(MVN) X(TST) X(TEQ) X(CMP) X(CMN)

/* Loads and stores of one value. Each has four forms:
 *   _I   r[n] + immediate (a signed number)                _L  the address `immediate` (PC-relative)
 *   _R   r[n] + (r[m] << amount)                           _W  r[n] + immediate with write-back, see `mode`
 * The transferred register is d. A load into d = 15 is a branch.
 */
#define ACCESS_OPERATIONS(X) X(LDR) X(LDRB) X(LDRH) X(LDRSB) X(LDRSH) X(STR) X(STRB) X(STRH)

/* Parallel additions and subtractions, six of each kind: ADD16, ASX, SAX, SUB16, ADD8, SUB8. d, n, m. */
#define PARALLEL_KINDS(X) X(S) X(Q) X(SH) X(U) X(UQ) X(UH)

#define DATA_FORMS(NAME) OP_##NAME##_I, OP_##NAME##_IS, OP_##NAME##_R, OP_##NAME##_RS, OP_##NAME##_X, OP_##NAME##_XS,
#define ACCESS_FORMS(NAME) OP_##NAME##_I, OP_##NAME##_R, OP_##NAME##_L, OP_##NAME##_W,
#define PARALLEL_FORMS(KIND) \
    OP_##KIND##ADD16, OP_##KIND##ASX, OP_##KIND##SAX, OP_##KIND##SUB16, OP_##KIND##ADD8, OP_##KIND##SUB8,

enum operation {
    OP_UNDEFINED,      /* UDF, and bits that match no encoding: UsageFault, UNDEFINSTR */
    OP_NO_COPROCESSOR, /* CDP, MCR, MRC, LDC, STC and similar: UsageFault, NOCP */
    DATA_OPERATIONS(DATA_FORMS)
    ACCESS_OPERATIONS(ACCESS_FORMS)
    PARALLEL_KINDS(PARALLEL_FORMS)
    /* Shifts by a register: d = n shifted by the low byte of r[m]; kind in `shift`; `sets_flags`: N, Z, C. */
    OP_SHIFT,
    OP_MOVT,  /* upper half of d = immediate */
    OP_MOV_PC, OP_ADD_PC, /* MOV pc, m and ADD pc, pc, m (n = 15): branches without interworking */
    OP_LDRD, OP_STRD, /* d and a at r[n] + immediate, `mode`; n = 15 (LDRD): the address `immediate` */
    OP_LDM, OP_STM, /* registers of the mask `immediate` at r[n], upward or, with MODE_BEFORE, downward; `mode` */
    OP_LDREX, OP_LDREXB, OP_LDREXH, /* d from r[n] + immediate */
    OP_STREX, OP_STREXB, OP_STREXH, /* a to r[n] + immediate, d = 0 if it was stored, else 1 */
    OP_CLREX,
    OP_TBB, OP_TBH, /* table at r[n], index r[m]; `immediate` is the address that the offsets count from if n = 15 */
    OP_MUL, /* d = n * m; `sets_flags` (N and Z) */
    OP_MLA, OP_MLS, /* d = a + n * m, d = a - n * m */
    OP_UMULL, OP_SMULL, OP_UMLAL, OP_SMLAL, OP_UMAAL, /* a (upper) and d (lower) from n * m */
    OP_SDIV, OP_UDIV,
    /* d = halves of n and m, `amount` bit 1: upper half of n, bit 0: upper half of m; + a, or nothing if a = 15 */
    OP_SMLA_HALVES, /* SMLAxy, SMULxy */
    OP_SMLAW, /* SMLAWy, SMULWy: n * half of m, >> 16; `amount` bit 0 */
    OP_SMLAL_HALVES, /* SMLALxy: a:d += half * half */
    /* Dual: two products of halves; `amount` bit 0 exchanges the halves of m. + r[a], or nothing if a = 15. */
    OP_SMLAD, OP_SMLSD, /* SMUAD and SMUSD with a = 15 */
    OP_SMLALD, OP_SMLSLD, /* a:d += */
    OP_SMMLA, OP_SMMLS, /* the upper word; `amount` bit 0 rounds; SMMUL is SMMLA with a = 15 */
    OP_USADA8, /* sum of absolute differences; USAD8 with a = 15 */
    OP_BFI, OP_BFC, /* `amount` is the lowest bit, `immediate` the mask of the field in d; BFI from n */
    OP_SBFX, OP_UBFX, /* from bit `amount` of n, `immediate` bits */
    /* Extension of r[m] rotated right by `amount` (0, 8, 16, 24), + r[n] or nothing if n = 15 */
    OP_SXTAB, OP_SXTAH, OP_UXTAB, OP_UXTAH, OP_SXTAB16, OP_UXTAB16,
    OP_CLZ, OP_RBIT, OP_REV, OP_REV16, OP_REVSH, /* d from m */
    OP_SSAT, OP_USAT, /* n, shifted by `shift` and `amount`, to `immediate` bits: signed range or unsigned */
    OP_SSAT16, OP_USAT16,
    OP_QADD, OP_QSUB, OP_QDADD, OP_QDSUB, /* d = m +- n, n doubled */
    OP_SEL, /* bytes of n or m by the GE flags */
    OP_PKHBT, OP_PKHTB, /* n and r[m] shifted by `amount` (PKHBT to the left, PKHTB arithmetically right, 1 to 32) */
    /* Control. The target of a direct branch is `immediate`; the return address follows from address and size. */
    OP_B, /* if `condition` holds */
    OP_BL, OP_BX, OP_BLX, /* BX and BLX: to r[m] */
    OP_CBZ, OP_CBNZ, /* r[n] */
    OP_IT, /* `immediate` is the eight bits of ITSTATE */
    OP_SVC, OP_BKPT, /* number `immediate` */
    OP_NOP, OP_YIELD, OP_WFE, OP_WFI, OP_SEV, /* PLD, PLI and unallocated hints are NOP */
    OP_DMB, OP_DSB, OP_ISB,
    OP_CPS, /* `amount` bit 1: PRIMASK, bit 0: FAULTMASK; `immediate` 1 sets, 0 clears */
    OP_MRS, OP_MSR, /* d from, n to special register SYSm = `immediate`; MSR: `amount` is the mask (2: flags, 1: GE) */
    /* Floating point, single precision. Registers d, n and m are numbers of s registers (0 to 31), unless noted. */
    OP_VADD, OP_VSUB, OP_VMUL, OP_VNMUL, OP_VDIV,
    OP_VMLA, OP_VMLS, OP_VNMLA, OP_VNMLS, /* rounded twice */
    OP_VFMA, OP_VFMS, OP_VFNMA, OP_VFNMS, /* fused */
    OP_VABS, OP_VNEG, OP_VSQRT, OP_VMOV, /* d from m */
    OP_VMOV_I, /* d = the bits `immediate` */
    OP_VCMP, OP_VCMP_ZERO, /* d with m, or with zero; `amount` 1: VCMPE, which signals quiet NaNs */
    OP_VCVT_TO_INTEGER, /* `amount` bit 0: signed, bit 1: VCVTR, by the rounding mode of FPSCR, else towards zero */
    OP_VCVT_FROM_INTEGER, /* `amount` bit 0: signed */
    /* d with `immediate` fraction bits; `amount` bit 0: signed, bit 1: 32 bits, else 16 */
    OP_VCVT_TO_FIXED, OP_VCVT_FROM_FIXED,
    OP_VCVT_TO_HALF, OP_VCVT_FROM_HALF, /* VCVTB, VCVTT; `amount` 1: upper half */
    OP_VMOV_TO_CORE, OP_VMOV_FROM_CORE, /* core register d, s register n; also VMOV.32 with a half of a d register */
    OP_VMOV_PAIR_TO_CORE, OP_VMOV_PAIR_FROM_CORE, /* core registers d and a, s registers m and m + 1 */
    OP_VMRS, OP_VMSR, /* FPSCR and core register d; VMRS to d = 15 copies the flags */
    OP_VLDR, OP_VSTR, /* s register d at r[n] + immediate, `words` 1, or 2 for a d register; n = 15 (VLDR): the address
                         `immediate` */
    OP_VLDM, OP_VSTM, /* `words` s registers from d on, at r[n]; `mode` */
    OPERATIONS
};

enum shift { SHIFT_LSL, SHIFT_LSR, SHIFT_ASR, SHIFT_ROR, SHIFT_RRX };

/* Addressing with write-back. */
enum mode {
    MODE_WRITES_BACK = 1,
    MODE_POST = 2,   /* LDR, LDRD and similar: access r[n], then add; otherwise add, then access */
    MODE_BEFORE = 4, /* LDMDB, STMDB, VLDMDB, VSTMDB: downward from r[n] */
};

enum { CONDITION_ALWAYS = 14 };

/* Instruction classes that a row of a timing profile prices; `ROW_NAMES` has the names in this order. */
#define COST_ROWS(X) \
    X(data) X(divide) X(it) X(it_skipped) X(barrier) X(system) X(exclusive) X(load) X(store) X(store_register_offset) \
    X(multiple_base) X(branch) X(table_branch) X(fp) X(fp_accumulate) X(fp_divide) X(fp_load) X(fp_store) \
    X(fp_move_pair) X(multiply) X(multiply_accumulate) X(multiply_long) X(accumulate_long)
#define ROW_ENUMERATOR(NAME) ROW_##NAME,
enum cost_row { COST_ROWS(ROW_ENUMERATOR) INSTRUCTION_ROWS };

enum transfer {
    TRANSFER_NONE,
    TRANSFER_DIRECT,   /* the target is in the instruction */
    TRANSFER_INDIRECT, /* the target comes from a register or from memory */
};

struct instruction {
    uint16_t operation; /* enum operation */
    uint8_t size;       /* bytes: 2 or 4 */
    uint8_t condition;  /* of B, or of an instruction in an IT block; CONDITION_ALWAYS otherwise */
    uint8_t d, n, m, a; /* registers */
    uint8_t shift;      /* enum shift */
    uint8_t amount;
    uint8_t mode;       /* enum mode, or 0 */
    uint8_t words;      /* of a multiple transfer (LDM, STM, LDRD, STRD, VLDM, VSTM, VLDR and VSTR of d registers) */
    bool sets_flags;
    uint8_t carry;      /* of a data-processing immediate that sets flags: 0 or 1, or 2 if C is unchanged */
    uint32_t immediate;

    /* For prices, see prices.h. Bit i of a mask is r[i], or s[i] for the fp_ ones. */
    uint8_t row;        /* enum cost_row */
    uint8_t transfer;   /* enum transfer */
    bool conditional;   /* a transfer that may fall through: B with condition, CBZ, CBNZ, any transfer in an IT block */
    bool in_it_block;
    bool uses_fpu;
    bool loads_multiple;/* LDM, LDRD, VLDM, or VLDR of a d register */
    bool moves_from_fpu;/* VMOV of one s register to a core register */
    bool sets_stack;    /* it sets the stack pointer other than by adding or subtracting a number or a register */
    uint16_t address_registers; /* sources of an access's address, without the PC */
    uint16_t loaded_registers;  /* destinations of a single load, without a base that is written back */
    uint16_t stepped_base;      /* base that a load of at most a word moves */
    uint16_t core_writes;       /* core registers written */
    uint32_t fp_reads, fp_writes;
    uint32_t fp_addend;         /* read only as the addend of a multiply-accumulate; not in fp_reads */
};

/* Decode the instruction that begins with `first`.
 *
 * address: address of the instruction, an even number. first, second: its halfwords; `second` is ignored if the
 * instruction has two bytes. it_state: ITSTATE before the instruction, 0 outside an IT block. In a block, 16-bit data
 * processing does not set flags (DDI 0403E, A7.3.2), and `condition` is the block's. baseline: instructions that
 * ARMv6-M does not have are OP_UNDEFINED. Every field of *decoded is written. UNPREDICTABLE encodings are decoded as by
 * Cortex-M4 silicon or, if its behaviour is unknown, as by the decoder of QEMU and Unicorn; encodings that neither
 * defines are OP_UNDEFINED.
 */
void decode_instruction(
    uint32_t address, uint16_t first, uint16_t second, uint8_t it_state, bool baseline, struct instruction *decoded);

/* Return the size of the instruction that begins with a halfword: 2 or 4 bytes. */
static inline uint8_t instruction_size(uint16_t first) { return first >> 11 >= 0x1D ? 4 : 2; }

/* Return ITSTATE after an instruction of an IT block (DDI 0403E, A7.3.3, ITAdvance). */
static inline uint8_t advance_it_state(uint8_t it_state)
{
    return it_state & 7 ? (uint8_t)((it_state & 0xE0) | (it_state << 1 & 0x1F)) : 0;
}

#endif
