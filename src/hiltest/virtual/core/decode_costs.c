/* Fields of an instruction for the cycle model, from its operation and its registers. */

#include "decode.h"

static uint16_t core_mask(uint32_t number) { return (uint16_t)(1u << number); }

/* Mask of `count` s registers from one on, at most up to s31. */
static uint32_t single_mask(uint32_t first, uint32_t count)
{
    return (uint32_t)(((UINT64_C(1) << count) - 1) << first);
}

static bool is_data(const struct instruction *i) { return i->operation >= OP_AND_I && i->operation < OP_LDR_I; }
static bool is_load(const struct instruction *i) { return i->operation >= OP_LDR_I && i->operation < OP_STR_I; }
static bool is_store(const struct instruction *i) { return i->operation >= OP_STR_I && i->operation < OP_SADD16; }

static int access_form(const struct instruction *i) { return (i->operation - OP_LDR_I) % ACCESS_FORM_COUNT; }

static bool writes_back(const struct instruction *i) { return i->mode & MODE_WRITES_BACK; }

static uint8_t row(const struct instruction *i)
{
    if (is_load(i)) return ROW_load;
    if (is_store(i)) return access_form(i) == ACCESS_REGISTER ? ROW_store_register_offset : ROW_store;
    switch (i->operation) {
    case OP_LDM: case OP_STM: case OP_LDRD: case OP_STRD: case OP_VLDM: case OP_VSTM: return ROW_multiple_base;
    case OP_VLDR: return i->words == 2 ? ROW_multiple_base : ROW_fp_load;
    case OP_VSTR: return i->words == 2 ? ROW_multiple_base : ROW_fp_store;
    case OP_LDREX: case OP_LDREXB: case OP_LDREXH: case OP_STREX: case OP_STREXB: case OP_STREXH: return ROW_exclusive;
    case OP_TBB: case OP_TBH: return ROW_table_branch;
    case OP_B: case OP_BL: case OP_BX: case OP_BLX: case OP_CBZ: case OP_CBNZ: case OP_MOV_PC: case OP_ADD_PC:
        return ROW_branch;
    case OP_SDIV: case OP_UDIV: return ROW_divide;
    case OP_MUL: return ROW_multiply;
    case OP_MLA: case OP_MLS: return ROW_multiply_accumulate;
    case OP_UMULL: case OP_SMULL: return ROW_multiply_long;
    case OP_UMLAL: case OP_SMLAL: case OP_UMAAL: return ROW_accumulate_long;
    case OP_IT: return ROW_it;
    case OP_DMB: case OP_DSB: case OP_ISB: return ROW_barrier;
    case OP_CLREX: case OP_SVC: case OP_BKPT: case OP_CPS: case OP_MRS: case OP_MSR: return ROW_system;
    case OP_VDIV: case OP_VSQRT: return ROW_fp_divide;
    case OP_VMLA: case OP_VMLS: case OP_VNMLA: case OP_VNMLS:
    case OP_VFMA: case OP_VFMS: case OP_VFNMA: case OP_VFNMS: return ROW_fp_accumulate;
    case OP_VMOV_PAIR_TO_CORE: case OP_VMOV_PAIR_FROM_CORE: return ROW_fp_move_pair;
    default: return i->operation >= OP_VADD ? ROW_fp : i->row; /* hints already have their row */
    }
}

/* Core registers that an operation writes as its result, without a base that is written back. */
static uint16_t results(const struct instruction *i)
{
    if (is_data(i)) return i->operation < OP_TST_I ? core_mask(i->d) : 0;
    if (is_load(i)) return core_mask(i->d);
    if (is_store(i)) return 0;
    switch (i->operation) {
    case OP_LDM: return (uint16_t)i->immediate;
    case OP_LDRD: case OP_VMOV_PAIR_TO_CORE:
    case OP_UMULL: case OP_SMULL: case OP_UMLAL: case OP_SMLAL: case OP_UMAAL: case OP_SMLAL_HALVES: case OP_SMLALD:
    case OP_SMLSLD: return core_mask(i->d) | core_mask(i->a);
    case OP_MOV_PC: case OP_ADD_PC: case OP_BX: return core_mask(PC);
    case OP_BL: case OP_BLX: return core_mask(LR) | core_mask(PC);
    case OP_B: case OP_CBZ: case OP_CBNZ: case OP_TBB: case OP_TBH: /* only branches */
    case OP_STM: case OP_STRD: case OP_CLREX: case OP_IT: case OP_SVC: case OP_BKPT: case OP_NOP: case OP_YIELD:
    case OP_WFE: case OP_WFI: case OP_SEV: case OP_DMB: case OP_DSB: case OP_ISB: case OP_CPS: case OP_MSR: return 0;
    case OP_VMRS: return i->d == PC ? 0 : core_mask(i->d); /* to the flags if d is 15 */
    default:
        if (i->operation < OP_VADD || i->operation == OP_VMOV_TO_CORE) return core_mask(i->d);
        return 0;
    }
}

static uint16_t address_registers(const struct instruction *i)
{
    uint16_t without_pc = (uint16_t)~core_mask(PC);
    if (is_load(i) || is_store(i)) {
        uint16_t index = access_form(i) == ACCESS_REGISTER ? core_mask(i->m) : 0;
        return (core_mask(i->n) | index) & without_pc;
    }
    switch (i->operation) {
    case OP_TBB: case OP_TBH: return (core_mask(i->n) | core_mask(i->m)) & without_pc;
    case OP_LDM: case OP_STM: case OP_LDRD: case OP_STRD: case OP_VLDM: case OP_VSTM: case OP_VLDR: case OP_VSTR:
    case OP_LDREX: case OP_LDREXB: case OP_LDREXH: case OP_STREX: case OP_STREXB: case OP_STREXH:
        return core_mask(i->n) & without_pc;
    default: return i->address_registers; /* hints already have theirs */
    }
}

static bool loads_multiple(const struct instruction *i)
{
    switch (i->operation) {
    case OP_LDM: case OP_LDRD: case OP_VLDM: return true;
    case OP_VLDR: return i->words == 2;
    default: return false;
    }
}

static void describe_transfer(struct instruction *i)
{
    switch (i->operation) {
    case OP_B: case OP_BL: case OP_CBZ: case OP_CBNZ: i->transfer = TRANSFER_DIRECT; break;
    case OP_TBB: case OP_TBH: i->transfer = TRANSFER_INDIRECT; break;
    default: i->transfer = i->core_writes & core_mask(PC) ? TRANSFER_INDIRECT : TRANSFER_NONE;
    }
    bool falls_through = i->condition != CONDITION_ALWAYS || i->operation == OP_CBZ || i->operation == OP_CBNZ;
    i->conditional = i->transfer != TRANSFER_NONE && (falls_through || i->in_it_block);
}

/* FSTMX and FLDMX, whose base moves by a word more than they transfer, are not VPUSH and VPOP. */
static bool is_on_stack(const struct instruction *i, uint8_t mode)
{
    return i->n == SP && i->mode == mode && i->immediate == 4u * i->words;
}

/* The s registers. In the cycle model VPUSH and VPOP have always waited for the registers of their lists, but no other
 * VSTM and VLDM; its measured counts depend on that. VCVT between fixed and floating point works in place. */
static void describe_singles(struct instruction *i)
{
    uint32_t d = single_mask(i->d & 31, 1), n = single_mask(i->n & 31, 1), m = single_mask(i->m & 31, 1);
    switch (i->operation) {
    case OP_VADD: case OP_VSUB: case OP_VMUL: case OP_VNMUL: case OP_VDIV: i->fp_reads = n | m; i->fp_writes = d; break;
    case OP_VMLA: case OP_VMLS: case OP_VNMLA: case OP_VNMLS:
    case OP_VFMA: case OP_VFMS: case OP_VFNMA: case OP_VFNMS:
        i->fp_reads = n | m;
        i->fp_writes = d;
        i->fp_addend = d & ~i->fp_reads;
        break;
    case OP_VMOV_I: i->fp_writes = d; break;
    case OP_VCMP: i->fp_reads = d | m; break;
    case OP_VCMP_ZERO: i->fp_reads = d; break;
    case OP_VCVT_TO_FIXED: case OP_VCVT_FROM_FIXED: i->fp_reads = i->fp_writes = d; break;
    case OP_VMOV_TO_CORE: i->fp_reads = n; break;
    case OP_VMOV_FROM_CORE: i->fp_writes = n; break;
    case OP_VMOV_PAIR_TO_CORE: i->fp_reads = m | m << 1; break;
    case OP_VMOV_PAIR_FROM_CORE: i->fp_writes = m | m << 1; break;
    case OP_VMRS: case OP_VMSR: break;
    case OP_VLDR: case OP_VLDM:
        i->fp_writes = single_mask(i->d, i->words);
        i->fp_reads = is_on_stack(i, MODE_WRITES_BACK) ? i->fp_writes : 0;
        break;
    case OP_VSTR: i->fp_reads = single_mask(i->d, i->words); break;
    case OP_VSTM: i->fp_reads = is_on_stack(i, MODE_WRITES_BACK | MODE_BEFORE) ? single_mask(i->d, i->words) : 0; break;
    default: i->fp_reads = m; i->fp_writes = d; /* VABS, VMOV, VSQRT, conversions */
    }
}

/* ADD and SUB of a number or a register to the stack pointer itself. */
static bool steps_stack(const struct instruction *i)
{
    bool is_sum = (i->operation >= OP_ADD_I && i->operation <= OP_ADD_XS)
                  || (i->operation >= OP_SUB_I && i->operation <= OP_SUB_XS);
    return is_sum && i->n == SP;
}

/* Special registers 8, 9 and 20: MSP, PSP and CONTROL, which says which of the two is the stack pointer (B5.2, MSR). */
static bool is_of_stack_pointer(uint32_t special) { return special == 8 || special == 9 || special == 20; }

static bool sets_stack(const struct instruction *i)
{
    if (i->operation == OP_MSR) return is_of_stack_pointer(i->immediate);
    bool is_moved = (writes_back(i) && i->n == SP) || steps_stack(i);
    return results(i) & core_mask(SP) && !is_moved;
}

void describe_costs(struct instruction *decoded)
{
    decoded->row = row(decoded);
    decoded->uses_fpu = decoded->operation >= OP_VADD;
    decoded->address_registers = address_registers(decoded);
    decoded->core_writes = results(decoded) | (writes_back(decoded) ? core_mask(decoded->n) : 0);
    if (decoded->row == ROW_load) decoded->loaded_registers = core_mask(decoded->d);
    if (decoded->row == ROW_load && writes_back(decoded)) decoded->stepped_base = core_mask(decoded->n);
    decoded->loads_multiple = loads_multiple(decoded);
    decoded->moves_from_fpu = decoded->operation == OP_VMOV_TO_CORE;
    if (decoded->uses_fpu) describe_singles(decoded);
    describe_transfer(decoded);
    decoded->sets_stack = sets_stack(decoded);
}
