/* The interpreter. It is compiled twice, see execute_waits.c, so that waits do not slow down machines without them. */
#include "execute.h"

#include <string.h>

#include "float.h"
#include "integer.h"
#include "registers.h"
#include "stacks.h"

#ifndef WAITS
#define WAITS false
#define EXECUTE execute
#endif

enum { LINK = 14, PC = 15 };

/* -- conditions and flags ---------------------------------------------------------------------------------------- */

static inline bool holds(const struct core *core, uint32_t condition)
{
    bool negative = core->negative >> 31, result;
    switch (condition >> 1) {
    case 0: result = core->zero == 0; break;
    case 1: result = core->carry; break;
    case 2: result = negative; break;
    case 3: result = core->overflow; break;
    case 4: result = core->carry && core->zero != 0; break;
    case 5: result = negative == (bool)core->overflow; break;
    case 6: result = core->zero != 0 && negative == (bool)core->overflow; break;
    default: return true;
    }
    return result != (bool)(condition & 1);
}

#if !WAITS
bool machine_skips(struct machine *machine)
{
    return machine->core.it_state && !holds(&machine->core, machine->core.it_state >> 4);
}
#endif

static inline void set_nz(struct core *core, uint32_t result) { core->negative = core->zero = result; }

/* AddWithCarry (DDI 0403E, A2.2.1). */
static inline uint32_t add_setting_flags(struct core *core, uint32_t a, uint32_t b, uint32_t carry)
{
    uint64_t sum = (uint64_t)a + b + carry;
    uint32_t result = (uint32_t)sum;
    core->carry = (uint32_t)(sum >> 32);
    core->overflow = ((a ^ result) & (b ^ result)) >> 31;
    set_nz(core, result);
    return result;
}

/* -- memory ------------------------------------------------------------------------------------------------------ */

/* Store the state that callbacks need: time and current instruction. */
#define PUBLISH() \
    (core->cycles = cycles, core->instructions = instructions, core->r[PC] = node->address, \
     core->it_state = node->it_state, machine->running = node)

/* CCR.UNALIGN_TRP: unaligned halfwords and words fault. */
static bool is_trapped(struct machine *machine, const struct node *node, uint32_t address, uint32_t size)
{
    if (!machine->core.unaligned_traps || address % size == 0)
        return false;
    note_fault(
        machine, FAULT_UNALIGNED, CAUSE_MISALIGNED, node->address, address, machine->core.r[node->instruction.n],
        node->instruction.n);
    return true;
}

/* -- waits of memories ------------------------------------------------------------------------------------------- */

static inline int32_t count_wait(struct machine *machine, struct node *node, int32_t wait)
{
    node->waited += wait;
    machine->core.memory_cycles += wait;
    return wait;
}

/* The same for waits by rows of the profile's costs, which depend on the address of an access. */
static inline int32_t count_address_wait(struct machine *machine, struct node *node, int32_t wait)
{
    machine->core.address_cycles += wait;
    return count_wait(machine, node, wait);
}

/* Return the cycles that an instruction waits which is fetched at a cycle. */
static inline int32_t fetch_wait(struct machine *machine, struct node *node, int64_t cycle)
{
    return WAITS && node->fetch_waits
        ? count_wait(machine, node, waits_fetch(machine->waits, node->address, node->instruction.size, cycle))
        : 0;
}

/* Return the cycles that an access takes longer because it is not at a multiple of its size: a part more, or two for a
 * word at an odd address (TRM, 3.3.2). */
static inline int32_t unaligned_wait(struct machine *machine, struct node *node, uint32_t address, uint32_t size)
{
    if ((address & (size - 1)) == 0)
        return 0;
    return count_address_wait(
        machine, node, machine->prices.value[ROW_unaligned] * (size == 4 && address % 2 ? 2 : 1));
}

/* Return the cycles that an access takes longer because it cannot overlap a load in another memory block. */
static inline int32_t block_wait(struct machine *machine, struct node *node, uint32_t address)
{
    const uint32_t last = machine->history.accessed_at;
    const int32_t cost = machine->prices.value[ROW_load_other_block];
    machine->history.accessed_at = address;
    if (!node->overlaps_load || cost == 0 || is_same_block(machine, last, address))
        return 0;
    return count_address_wait(machine, node, cost);
}

/* Return whether an access that overlaps a load never waits. */
static inline bool never_waits(const struct memory_waits *waits, uint32_t address)
{
    return !waits->has_conflicts && address - waits->flash.begin >= waits->flash.bytes;
}

/* Return the wait of the instruction's only access, or of its first one [cycles]. */
static inline int32_t access_wait(
    struct machine *machine, struct node *node, uint32_t address, uint32_t size, int64_t cycle)
{
    int32_t wait = unaligned_wait(machine, node, address, size) + block_wait(machine, node, address);
    if (!WAITS || (node->access == ACCESS_NONE && !node->fetch_waits && never_waits(machine->waits, address)))
        return wait;
    const int32_t of_memory = waits_access(
        machine->waits, node->address, node->instruction.words, true, node->access, address, size, cycle + wait);
    return wait + count_wait(machine, node, of_memory);
}

/* Return the cycles that the words of a transfer wait. */
static int32_t transfer_wait(struct machine *machine, struct node *node, uint32_t address, int64_t cycle)
{
    const uint32_t words = node->instruction.words;
    return count_wait(machine, node, waits_transfer(machine->waits, node->address, words, node->access, address, cycle));
}

/* Return whether an instruction that jumps to itself never waits. */
static inline bool is_settled(const struct machine *machine, const struct node *node)
{
    return !WAITS || waits_are_over(machine->waits, node->address, node->instruction.size);
}

static inline void forget_fetched_word(struct machine *machine, int64_t cycle)
{
    if (WAITS)
        waits_jump(machine->waits, cycle);
}

/* Called after a write to r13: its lowest bits stay zero (DDI 0403E, B1.4.7), and it may have a new lowest value.
 * `next` is the next instruction: a switch of stacks jumps to the function that begins on the new one. */
static inline void follow_stack(struct machine *machine, const struct node *node, uint32_t next)
{
    machine->core.r[13] &= ~3u;
    check_stack(machine, node->instruction.sets_stack, next);
}

/* -- floating point ---------------------------------------------------------------------------------------------- */

/* Switch the FPU to this context (ExecuteFPCheck): save the state that an exception saves lazily, and make the next
 * exception save this context's. */
static void prepare_floating_point(struct machine *machine)
{
    struct core *core = &machine->core;
    machine_save_floats(machine);
    if (core->floating_control & FPCCR_ASPEN && !(core->control & CONTROL_FPCA)) {
        core->control |= CONTROL_FPCA;
        core->fpscr = (core->fpscr & ~FPDSCR_BITS) | (core->floating_default & FPDSCR_BITS);
    }
}

static bool floating_point_is_ready(const struct core *core)
{
    return !core->lazy_frame && (core->control & CONTROL_FPCA || !(core->floating_control & FPCCR_ASPEN));
}

static inline uint32_t negated(uint32_t value) { return value ^ 0x80000000u; }

/* Multiply-accumulate, rounded once or twice; the operations' pages say which operands are negated. */
static uint32_t accumulate(uint16_t operation, uint32_t d, uint32_t n, uint32_t m, uint32_t *fpscr)
{
    switch (operation) {
    case OP_VFMA: return float_multiply_add(d, n, m, fpscr);
    case OP_VFMS: return float_multiply_add(d, negated(n), m, fpscr);
    case OP_VFNMA: return float_multiply_add(negated(d), negated(n), m, fpscr);
    case OP_VFNMS: return float_multiply_add(negated(d), n, m, fpscr);
    case OP_VMLA: return float_add(d, float_multiply(n, m, fpscr), fpscr);
    case OP_VMLS: return float_add(d, negated(float_multiply(n, m, fpscr)), fpscr);
    case OP_VNMLA: return float_add(negated(d), negated(float_multiply(n, m, fpscr)), fpscr);
    default: return float_add(negated(d), float_multiply(n, m, fpscr), fpscr);
    }
}

static void convert(struct core *core, const struct instruction *i)
{
    uint32_t m = core->s[i->m], bits = i->amount & 2 ? 32 : 16;
    bool is_signed = i->amount & 1;
    uint32_t *d = &core->s[i->d];
    switch (i->operation) {
    case OP_VCVT_TO_INTEGER: *d = float_to_fixed(m, 32, 0, is_signed, !(i->amount & 2), &core->fpscr); break;
    case OP_VCVT_FROM_INTEGER: *d = float_from_fixed(m, 32, 0, is_signed, false, &core->fpscr); break;
    case OP_VCVT_TO_FIXED: *d = float_to_fixed(*d, bits, i->immediate, is_signed, true, &core->fpscr); break;
    case OP_VCVT_FROM_FIXED: *d = float_from_fixed(*d, bits, i->immediate, is_signed, true, &core->fpscr); break;
    case OP_VCVT_TO_HALF: {
        uint32_t half = float_to_half(m, &core->fpscr);
        *d = i->amount ? (*d & 0xFFFF) | half << 16 : (*d & 0xFFFF0000u) | half;
        break;
    }
    default: *d = float_from_half(i->amount ? m >> 16 : m & 0xFFFF, &core->fpscr); break;
    }
}

static void move_status(struct core *core, const struct instruction *i)
{
    if (i->operation == OP_VMSR) {
        core->fpscr = core->r[i->d] & FPSCR_WRITABLE;
    } else if (i->d != PC) {
        core->r[i->d] = core->fpscr;
    } else {
        core->negative = core->fpscr;
        core->zero = ~core->fpscr >> 30 & 1;
        core->carry = core->fpscr >> 29 & 1;
        core->overflow = core->fpscr >> 28 & 1;
    }
}

/* Execute rare floating-point operations. */
static void compute_float(struct core *core, const struct instruction *i)
{
    uint32_t n = core->s[i->n], m = core->s[i->m], *d = &core->s[i->d], *fpscr = &core->fpscr;
    switch (i->operation) {
    case OP_VNMUL: *d = negated(float_multiply(n, m, fpscr)); break;
    case OP_VDIV: *d = float_divide(n, m, fpscr); break;
    case OP_VMLA: case OP_VMLS: case OP_VNMLA: case OP_VNMLS: case OP_VFMS: case OP_VFNMA: case OP_VFNMS:
        *d = accumulate(i->operation, *d, n, m, fpscr);
        break;
    case OP_VABS: *d = m & 0x7FFFFFFF; break;
    case OP_VNEG: *d = negated(m); break;
    case OP_VSQRT: *d = float_square_root(m, fpscr); break;
    case OP_VCMP: case OP_VCMP_ZERO: {
        uint32_t flags = float_compare(*d, i->operation == OP_VCMP ? m : 0, i->amount, fpscr);
        *fpscr = (*fpscr & ~FPSCR_FLAGS) | flags;
        break;
    }
    case OP_VMOV_PAIR_TO_CORE:
        core->r[i->d] = m;
        core->r[i->a] = core->s[(i->m + 1) & 31];
        break;
    case OP_VMOV_PAIR_FROM_CORE:
        core->s[i->m] = core->r[i->d];
        core->s[(i->m + 1) & 31] = core->r[i->a];
        break;
    case OP_VMRS: case OP_VMSR: move_status(core, i); break;
    default: convert(core, i); break;
    }
}

/* -- integer operations that do not need a case of their own ------------------------------------------------------ */

static void multiply_long(struct core *core, const struct instruction *i)
{
    uint32_t n = core->r[i->n], m = core->r[i->m];
    uint64_t sum = (uint64_t)core->r[i->a] << 32 | core->r[i->d];
    uint64_t exchanged = i->amount & 1 ? rotate_right(m, 16) : m;
    int64_t low = (int64_t)signed_half(n, 0) * signed_half((uint32_t)exchanged, 0);
    int64_t high = (int64_t)signed_half(n, 1) * signed_half((uint32_t)exchanged, 1);
    switch (i->operation) {
    case OP_UMULL: sum = (uint64_t)n * m; break;
    case OP_SMULL: sum = (uint64_t)((int64_t)as_signed(n) * as_signed(m)); break;
    case OP_UMLAL: sum += (uint64_t)n * m; break;
    case OP_SMLAL: sum += (uint64_t)((int64_t)as_signed(n) * as_signed(m)); break;
    case OP_UMAAL: sum = (uint64_t)n * m + core->r[i->a] + core->r[i->d]; break;
    case OP_SMLAL_HALVES:
        sum += (uint64_t)((int64_t)signed_half(n, i->amount >> 1) * signed_half(m, i->amount & 1));
        break;
    case OP_SMLALD: sum += (uint64_t)(low + high); break;
    default: sum += (uint64_t)(low - high); break; /* SMLSLD */
    }
    core->r[i->d] = (uint32_t)sum;
    core->r[i->a] = (uint32_t)(sum >> 32);
}

/* Return a sum of 32 bits, and set Q if it overflows. */
static uint32_t add_setting_q(struct core *core, int64_t a, int64_t b)
{
    int64_t sum = a + b;
    if (sum != (int32_t)sum)
        core->saturated = 1;
    return (uint32_t)sum;
}

static void multiply_signed(struct core *core, const struct instruction *i)
{
    uint32_t n = core->r[i->n], m = core->r[i->m], *d = &core->r[i->d];
    int64_t addend = i->a == PC ? 0 : as_signed(core->r[i->a]);
    uint32_t exchanged = i->amount & 1 ? rotate_right(m, 16) : m;
    int64_t low = (int64_t)signed_half(n, 0) * signed_half(exchanged, 0);
    int64_t high = (int64_t)signed_half(n, 1) * signed_half(exchanged, 1);
    int64_t product;
    switch (i->operation) {
    case OP_SMLA_HALVES:
        product = (int64_t)signed_half(n, i->amount >> 1) * signed_half(m, i->amount & 1);
        *d = i->a == PC ? (uint32_t)product : add_setting_q(core, product, addend);
        break;
    case OP_SMLAW:
        product = ((int64_t)as_signed(n) * signed_half(m, i->amount & 1)) >> 16;
        *d = i->a == PC ? (uint32_t)product : add_setting_q(core, product, addend);
        break;
    case OP_SMLAD: *d = add_setting_q(core, low + high, addend); break;
    case OP_SMLSD: *d = add_setting_q(core, low - high, addend); break;
    default: { /* SMMLA, SMMLS: the upper halves of the products, with sums that wrap */
        uint64_t sum = (uint64_t)addend << 32;
        uint64_t whole = (uint64_t)((int64_t)as_signed(n) * as_signed(m));
        sum = i->operation == OP_SMMLA ? sum + whole : sum - whole;
        *d = (uint32_t)((sum + (i->amount & 1 ? 0x80000000u : 0)) >> 32);
        break;
    }
    }
}

static uint32_t extend(const struct core *core, const struct instruction *i)
{
    uint32_t value = rotate_right(core->r[i->m], i->amount), base = i->n == PC ? 0 : core->r[i->n];
    uint32_t low = value & 0xFF, high = value >> 16 & 0xFF;
    switch (i->operation) {
    case OP_SXTAB: return base + (uint32_t)sign_extend(value, 8);
    case OP_SXTAH: return base + (uint32_t)sign_extend(value, 16);
    case OP_UXTAB: return base + low;
    case OP_UXTAH: return base + (value & 0xFFFF);
    case OP_SXTAB16:
        low = (uint32_t)sign_extend(low, 8);
        high = (uint32_t)sign_extend(high, 8);
        break;
    default: break; /* UXTAB16 */
    }
    return ((base + low) & 0xFFFF) | ((base >> 16) + high) << 16;
}

static uint32_t saturate(struct core *core, const struct instruction *i)
{
    uint32_t n = core->r[i->n], m = core->r[i->m], ignored = 0, *q = &core->saturated;
    switch (i->operation) {
    case OP_SSAT: return saturate_signed(as_signed(shift_value(n, i->shift, i->amount, &ignored)), i->immediate, q);
    case OP_USAT: return saturate_unsigned(as_signed(shift_value(n, i->shift, i->amount, &ignored)), i->immediate, q);
    case OP_SSAT16:
        return (saturate_signed(signed_half(n, 0), i->immediate, q) & 0xFFFF)
            | saturate_signed(signed_half(n, 1), i->immediate, q) << 16;
    case OP_USAT16:
        return saturate_unsigned(signed_half(n, 0), i->immediate, q)
            | saturate_unsigned(signed_half(n, 1), i->immediate, q) << 16;
    default: break;
    }
    int64_t doubled = as_signed(n);
    if (i->operation == OP_QDADD || i->operation == OP_QDSUB)
        doubled = as_signed(saturate_signed(2 * doubled, 32, q));
    bool adds = i->operation == OP_QADD || i->operation == OP_QDADD;
    return saturate_signed(adds ? as_signed(m) + doubled : as_signed(m) - doubled, 32, q);
}

static uint32_t select_bytes(const struct core *core, const struct instruction *i)
{
    uint32_t mask = (core->ge & 1 ? 0xFFu : 0) | (core->ge & 2 ? 0xFF00u : 0) | (core->ge & 4 ? 0xFF0000u : 0)
        | (core->ge & 8 ? 0xFF000000u : 0);
    return (core->r[i->n] & mask) | (core->r[i->m] & ~mask);
}

static uint32_t pack_halves(const struct core *core, const struct instruction *i)
{
    uint32_t n = core->r[i->n], m = core->r[i->m], ignored = 0;
    if (i->operation == OP_PKHBT)
        return (n & 0xFFFF) | (shift_value(m, SHIFT_LSL, i->amount, &ignored) & 0xFFFF0000u);
    return (n & 0xFFFF0000u) | (shift_value(m, SHIFT_ASR, i->amount, &ignored) & 0xFFFF);
}

/* Integer operations without flags or transfers; `compute_rest` is their default case in `execute`. */
static void compute_rest(struct core *core, const struct instruction *i)
{
    uint32_t n = core->r[i->n], m = core->r[i->m], *d = &core->r[i->d];
    uint16_t operation = i->operation;
    if (operation >= OP_SADD16 && operation <= OP_UHSUB8) {
        uint32_t index = operation - OP_SADD16;
        *d = parallel(n, m, (enum parallel_kind)(index / 6), (enum parallel_form)(index % 6), &core->ge);
        return;
    }
    switch (operation) {
    case OP_UMULL: case OP_SMULL: case OP_UMLAL: case OP_SMLAL: case OP_UMAAL: case OP_SMLAL_HALVES: case OP_SMLALD:
    case OP_SMLSLD:
        multiply_long(core, i);
        break;
    case OP_SMLA_HALVES: case OP_SMLAW: case OP_SMLAD: case OP_SMLSD: case OP_SMMLA: case OP_SMMLS:
        multiply_signed(core, i);
        break;
    case OP_USADA8: *d = absolute_differences(n, m) + (i->a == PC ? 0 : core->r[i->a]); break;
    case OP_SXTAB: case OP_SXTAH: case OP_UXTAB: case OP_UXTAH: case OP_SXTAB16: case OP_UXTAB16:
        *d = extend(core, i);
        break;
    case OP_CLZ: *d = count_leading_zeros(m); break;
    case OP_RBIT: *d = reverse_bits(m); break;
    case OP_REV: *d = reverse_bytes(m); break;
    case OP_REV16: *d = rotate_right(reverse_bytes(m), 16); break;
    case OP_REVSH: *d = (uint32_t)sign_extend(reverse_bytes(m) >> 16, 16); break;
    case OP_SSAT: case OP_USAT: case OP_SSAT16: case OP_USAT16: case OP_QADD: case OP_QSUB: case OP_QDADD:
    case OP_QDSUB:
        *d = saturate(core, i);
        break;
    case OP_SEL: *d = select_bytes(core, i); break;
    case OP_PKHBT: case OP_PKHTB: *d = pack_halves(core, i); break;
    default: break;
    }
}

/* -- the loop ---------------------------------------------------------------------------------------------------- */

/* Return the cycle up to which to execute, after a possible request for a check. */
static int64_t nearest(const struct machine *machine, int64_t horizon)
{
    if (machine->must_check)
        return INT64_MIN;
    return earlier(horizon, earlier(machine->core.deadline, machine_next_event(machine)));
}

/* Return the next node, or NULL if `machine_run` has to make room or find a fault first. */
static struct node *follow(struct machine *machine, uint32_t address, uint8_t it_state, uint16_t state)
{
    return code_is_full(machine) || address == machine->core.return_address
        ? NULL
        : code_at(machine, address, it_state, state);
}

/* Return the node after another one as above, and link it unless a profile has to see each passage. */
static struct node *follow_behind(
    struct machine *machine, struct node *node, struct node **link, uint8_t it_state, uint16_t state)
{
    uint32_t behind = node->address + node->instruction.size;
    bool links = !machine->profiles || profile_follow(machine, node, behind, false);
    struct node *next = follow(machine, behind, it_state, state);
    if (links)
        *link = next;
    return next;
}

/* Set the core's state to that before an instruction at an address. */
static void stand_at(struct machine *machine, uint32_t address, uint8_t it_state, uint16_t state)
{
    machine->core.r[PC] = address;
    machine->core.it_state = it_state;
    machine->running = NULL;
    machine->standing = state;
    memcpy(&machine->history.pipeline, code_state(machine, state), sizeof machine->history.pipeline);
}

/* The six forms of a data-processing operation. VALUE computes from `a` (r[n]) and `b`; FLAGS also sets the flags,
 * with the shifter's carry in `shifter`. */
#define DATA_CASES(NAME, VALUE, FLAGS) \
    case OP_##NAME##_I: { uint32_t a = r[i->n], b = i->immediate; (void)a; VALUE; break; } \
    case OP_##NAME##_R: { uint32_t a = r[i->n], b = r[i->m]; (void)a; VALUE; break; } \
    case OP_##NAME##_X: { \
        uint32_t a = r[i->n], shifter = core->carry, b = shift_value(r[i->m], i->shift, i->amount, &shifter); \
        (void)a; VALUE; break; } \
    FLAG_CASES(NAME, FLAGS)
#define FLAG_CASES(NAME, FLAGS) \
    case OP_##NAME##_IS: { \
        uint32_t a = r[i->n], b = i->immediate, shifter = i->carry == 2 ? core->carry : i->carry; \
        (void)a; (void)shifter; FLAGS; break; } \
    case OP_##NAME##_RS: { \
        uint32_t a = r[i->n], b = r[i->m], shifter = core->carry; (void)a; (void)shifter; FLAGS; break; } \
    case OP_##NAME##_XS: { \
        uint32_t a = r[i->n], shifter = core->carry, b = shift_value(r[i->m], i->shift, i->amount, &shifter); \
        (void)a; FLAGS; break; }
#define LOGICAL(EXPRESSION) (set_nz(core, r[i->d] = (EXPRESSION)), core->carry = shifter)
#define TESTS(EXPRESSION) (set_nz(core, (EXPRESSION)), core->carry = shifter)

#define FAULT_UNLESS(ACCESS) \
    do { \
        if (!(ACCESS)) \
            goto faulted; \
    } while (0)

/* An access outside directly accessible bytes: publish, then continue from the state that may have changed. */
#define ELSEWHERE(ACCESS) \
    do { \
        PUBLISH(); \
        FAULT_UNLESS(ACCESS); \
        cycles = core->cycles; \
        horizon = nearest(machine, limit); \
    } while (0)

/* A transfer of `words` words. */
#define TRANSFER(ACCESS) \
    do { \
        const uint32_t first_word = WAITS ? transfer_address(core, i) : 0; \
        ELSEWHERE(ACCESS); \
        if (WAITS) \
            cycles += transfer_wait(machine, node, first_word, cycles); \
    } while (0)
/* An exclusive access, which happens if HAPPENS is true afterwards. */
#define EXCLUSIVE(ACCESS, SIZE, HAPPENS) \
    do { \
        const uint32_t address = r[i->n] + i->immediate; \
        ELSEWHERE(ACCESS(machine, i, SIZE)); \
        if (HAPPENS) \
            cycles += access_wait(machine, node, address, SIZE, cycles); \
    } while (0)

#define LOAD_CASE(TYPE, SIZE, ADDRESS, BEHIND) \
    { \
        uint32_t address = (ADDRESS), value; \
        const uint8_t *bytes = plain_bytes(machine, address, SIZE); \
        if (bytes && !(SIZE > 1 && core->unaligned_traps)) { \
            TYPE loaded; \
            memcpy(&loaded, bytes, SIZE); \
            value = (uint32_t)loaded; \
        } else { \
            ELSEWHERE(!is_trapped(machine, node, address, SIZE) && load(machine, address, SIZE, &value)); \
            value = (uint32_t)(TYPE)value; \
        } \
        cycles += access_wait(machine, node, address, SIZE, cycles); \
        BEHIND; \
        if (i->d == PC) { \
            target = value; \
            goto jumps; \
        } \
        r[i->d] = value; \
        break; \
    }
#define STORE_CASE(TYPE, SIZE, ADDRESS, BEHIND) \
    { \
        uint32_t address = (ADDRESS), value = r[i->d]; \
        uint8_t *bytes = writable_bytes(machine, address, SIZE); \
        if (bytes && !(SIZE > 1 && core->unaligned_traps)) { \
            TYPE stored = (TYPE)value; \
            memcpy(bytes, &stored, SIZE); \
        } else { \
            ELSEWHERE(!is_trapped(machine, node, address, SIZE) \
                && store(machine, address, SIZE, SIZE == 4 ? value : value & ((1u << 8 * (SIZE & 3)) - 1))); \
        } \
        cycles += access_wait(machine, node, address, SIZE, cycles); \
        BEHIND; \
        break; \
    }
/* The four forms of an access. */
#define ACCESS_CASES(NAME, CASE, TYPE, SIZE) \
    case OP_##NAME##_I: CASE(TYPE, SIZE, r[i->n] + i->immediate, ) \
    case OP_##NAME##_R: CASE(TYPE, SIZE, r[i->n] + (r[i->m] << i->amount), ) \
    case OP_##NAME##_L: CASE(TYPE, SIZE, i->immediate, ) \
    case OP_##NAME##_W: \
        CASE(TYPE, SIZE, i->mode & MODE_POST ? r[i->n] : r[i->n] + i->immediate, r[i->n] += i->immediate)

#define FLOAT_IS_READY() \
    do { \
        if (!float_ready) { \
            PUBLISH(); \
            prepare_floating_point(machine); \
            cycles = core->cycles; \
            float_ready = true; \
        } \
    } while (0)

enum outcome EXECUTE(struct machine *machine, struct node *node, int64_t limit)
{
    struct core *core = &machine->core;
    uint32_t *r = core->r;
    int64_t cycles = core->cycles, instructions = core->instructions, horizon = nearest(machine, limit);
    const struct node *passed = core->passes_breakpoint ? node : NULL;
    bool float_ready = floating_point_is_ready(core);
    enum outcome outcome = RAN;

    core->passes_breakpoint = false;
    do {
        const struct instruction *i = &node->instruction;
        uint16_t operation = node->operation;
        struct node *from;
        uint32_t target;
    dispatch:
        switch (operation) {
        case OP_MARKED:
            if (node->marks & MARK_BREAKPOINT && node != passed && !(i->in_it_block && !holds(core, i->condition))) {
                outcome = BROKE;
                goto stands;
            }
            passed = NULL;
            if (node->marks & MARK_WATCHED) {
                PUBLISH();
                calls_arrive(machine, node);
                horizon = nearest(machine, limit);
            }
            /* fall through */
        case OP_IN_IT_BLOCK:
            if (i->in_it_block && !holds(core, i->condition))
                goto skips;
            /* fall through */
        case OP_FPU_DISABLED:
            if (i->uses_fpu && !core->fpu_enabled) {
                cycles += fetch_wait(machine, node, cycles);
                note_fault(machine, FAULT_NO_COPROCESSOR, CAUSE_FPU_DISABLED, node->address, 0, 0, 0);
                goto faulted;
            }
            /* fall through */
        case OP_FETCH_WAITS:
            cycles += fetch_wait(machine, node, cycles);
            /* fall through */
        case OP_READS_PC:
            r[PC] = node->address + 4;
            operation = i->operation;
            goto dispatch;

        case OP_UNDEFINED: {
            uint16_t halfword = 0;
            fetch(machine, node->address, &halfword);
            note_fault(machine, FAULT_UNDEFINED_INSTRUCTION, CAUSE_OPCODE, node->address, 0, halfword, 0);
            goto faulted;
        }
        case OP_NO_COPROCESSOR:
            note_fault(machine, FAULT_NO_COPROCESSOR, CAUSE_COPROCESSOR, node->address, 0, 0, 0);
            goto faulted;

        DATA_CASES(AND, r[i->d] = a & b, LOGICAL(a & b))
        DATA_CASES(BIC, r[i->d] = a & ~b, LOGICAL(a & ~b))
        DATA_CASES(ORR, r[i->d] = a | b, LOGICAL(a | b))
        DATA_CASES(ORN, r[i->d] = a | ~b, LOGICAL(a | ~b))
        DATA_CASES(EOR, r[i->d] = a ^ b, LOGICAL(a ^ b))
        DATA_CASES(MOV, r[i->d] = b, LOGICAL(b))
        DATA_CASES(MVN, r[i->d] = ~b, LOGICAL(~b))
        DATA_CASES(ADD, r[i->d] = a + b, r[i->d] = add_setting_flags(core, a, b, 0))
        DATA_CASES(ADC, r[i->d] = a + b + core->carry, r[i->d] = add_setting_flags(core, a, b, core->carry))
        DATA_CASES(SUB, r[i->d] = a - b, r[i->d] = add_setting_flags(core, a, ~b, 1))
        DATA_CASES(SBC, r[i->d] = a + ~b + core->carry, r[i->d] = add_setting_flags(core, a, ~b, core->carry))
        DATA_CASES(RSB, r[i->d] = b - a, r[i->d] = add_setting_flags(core, ~a, b, 1))
        FLAG_CASES(TST, TESTS(a & b))
        FLAG_CASES(TEQ, TESTS(a ^ b))
        FLAG_CASES(CMP, add_setting_flags(core, a, ~b, 1))
        FLAG_CASES(CMN, add_setting_flags(core, a, b, 0))

        case OP_SHIFT: {
            uint32_t shifter = core->carry;
            r[i->d] = shift_value(r[i->n], i->shift, r[i->m] & 0xFF, &shifter);
            if (i->sets_flags) {
                set_nz(core, r[i->d]);
                core->carry = shifter;
            }
            break;
        }
        case OP_MOVT: r[i->d] = (r[i->d] & 0xFFFF) | i->immediate << 16; break;
        case OP_MUL:
            r[i->d] = r[i->n] * r[i->m];
            if (i->sets_flags)
                set_nz(core, r[i->d]);
            break;
        case OP_MLA: r[i->d] = r[i->a] + r[i->n] * r[i->m]; break;
        case OP_MLS: r[i->d] = r[i->a] - r[i->n] * r[i->m]; break;
        case OP_UDIV: case OP_SDIV: {
            uint32_t n = r[i->n], m = r[i->m];
            if (m == 0 && core->divide_traps) {
                note_fault(machine, FAULT_DIVIDE_BY_ZERO, CAUSE_DIVISOR, node->address, 0, 0, i->m);
                goto faulted;
            }
            if (i->operation == OP_UDIV)
                r[i->d] = m ? n / m : 0;
            else if (n == 0x80000000u && m == 0xFFFFFFFFu)
                r[i->d] = n;
            else
                r[i->d] = m ? (uint32_t)(as_signed(n) / as_signed(m)) : 0;
            break;
        }
        case OP_BFI: r[i->d] = (r[i->d] & ~i->immediate) | (r[i->n] << i->amount & i->immediate); break;
        case OP_BFC: r[i->d] &= ~i->immediate; break;
        case OP_UBFX: r[i->d] = r[i->n] << ((32 - i->amount - i->immediate) & 31) >> ((32 - i->immediate) & 31); break;
        case OP_SBFX: r[i->d] = (uint32_t)sign_extend(r[i->n] >> i->amount, i->immediate); break;

        ACCESS_CASES(LDR, LOAD_CASE, uint32_t, 4)
        ACCESS_CASES(LDRB, LOAD_CASE, uint8_t, 1)
        ACCESS_CASES(LDRH, LOAD_CASE, uint16_t, 2)
        ACCESS_CASES(LDRSB, LOAD_CASE, int8_t, 1)
        ACCESS_CASES(LDRSH, LOAD_CASE, int16_t, 2)
        ACCESS_CASES(STR, STORE_CASE, uint32_t, 4)
        ACCESS_CASES(STRB, STORE_CASE, uint8_t, 1)
        ACCESS_CASES(STRH, STORE_CASE, uint16_t, 2)

        case OP_LDM:
            TRANSFER(load_multiple(machine, i, &target));
            if (i->immediate >> PC & 1)
                goto jumps;
            break;
        case OP_STM: TRANSFER(store_multiple(machine, i)); break;
        case OP_LDRD: TRANSFER(load_double(machine, i)); break;
        case OP_STRD: TRANSFER(store_double(machine, i)); break;
        case OP_LDREX: EXCLUSIVE(load_exclusive, 4, true); break;
        case OP_LDREXB: EXCLUSIVE(load_exclusive, 1, true); break;
        case OP_LDREXH: EXCLUSIVE(load_exclusive, 2, true); break;
        case OP_STREX: EXCLUSIVE(store_exclusive, 4, !r[i->d]); break;
        case OP_STREXB: EXCLUSIVE(store_exclusive, 1, !r[i->d]); break;
        case OP_STREXH: EXCLUSIVE(store_exclusive, 2, !r[i->d]); break;
        case OP_CLREX: machine->history.exclusive = false; break;

        case OP_TBB: case OP_TBH: {
            uint32_t base = i->n == PC ? node->address + 4 : r[i->n], size = i->operation == OP_TBH ? 2 : 1;
            uint32_t offset = 0, address = base + r[i->m] * size;
            ELSEWHERE(!is_trapped(machine, node, address, size) && load(machine, address, size, &offset));
            cycles += access_wait(machine, node, address, size, cycles);
            target = node->address + 4 + 2 * offset + 1;
            goto jumps;
        }
        case OP_B:
            if (i->condition != CONDITION_ALWAYS && !i->in_it_block && !holds(core, i->condition))
                break;
            if (i->immediate == node->address) {
                if (!core->may_loop) {
                    core->passes_breakpoint = node->marks & MARK_BREAKPOINT; /* the breakpoint has been reported */
                    outcome = LOOPED;
                    goto stands;
                }
                if (node->taken == node && horizon > cycles && node->taken_cost > 0 && !node->marks
                    && is_settled(machine, node)) {
                    int64_t rounds = (horizon - cycles - 1) / node->taken_cost;
                    cycles += rounds * node->taken_cost;
                    instructions += rounds;
                    node->jumps += (uint64_t)rounds;
                }
            }
            goto branches;
        case OP_BL:
            r[LINK] = (node->address + 4) | 1;
            goto branches;
        case OP_BLX:
            target = r[i->m];
            r[LINK] = (node->address + 2) | 1;
            goto jumps;
        case OP_BX: target = r[i->m]; goto jumps;
        case OP_MOV_PC: target = r[i->m] | 1; goto jumps_within;
        case OP_ADD_PC: target = (node->address + 4 + r[i->m]) | 1; goto jumps_within;
        case OP_CBZ:
            if (r[i->n])
                break;
            goto branches;
        case OP_CBNZ:
            if (!r[i->n])
                break;
            goto branches;

        case OP_IT: case OP_NOP: case OP_YIELD: case OP_DMB: case OP_DSB: case OP_ISB: break;
        case OP_SEV: core->event = true; break;
        case OP_WFE:
            if (core->event || (core->sends_on_pend && core->newly_pending)) {
                core->event = core->newly_pending = false;
                break;
            }
            core->newly_pending = false;
            /* fall through */
        case OP_WFI:
            core->waits_for_event = i->operation == OP_WFE;
            core->sleeping = true;
            outcome = SLEPT;
            break;
        case OP_SVC:
            PUBLISH();
            if (machine_preemption_priority(machine, EXCEPTION_SVCALL)
                < machine_execution_priority(machine, machine_ceiling(machine, false))) {
                machine_pend(machine, EXCEPTION_SVCALL);
            } else {
                note_fault(machine, FAULT_SUPERVISOR_CALL, CAUSE_SVC, node->address, 0, i->immediate, 0);
                outcome = FAULTED;
            }
            horizon = INT64_MIN;
            break;
        case OP_BKPT:
            note_fault(machine, FAULT_BREAKPOINT, CAUSE_BKPT, node->address, 0, i->immediate, 0);
            goto faulted;
        case OP_CPS:
            change_masks(machine, i);
            horizon = nearest(machine, limit);
            break;
        case OP_MRS: r[i->d] = read_special(machine, i->immediate); break;
        case OP_MSR:
            write_special(machine, i->immediate, i->amount, r[i->n]);
            float_ready = floating_point_is_ready(core);
            horizon = nearest(machine, limit);
            break;

        case OP_VADD: FLOAT_IS_READY(); core->s[i->d] = float_add(core->s[i->n], core->s[i->m], &core->fpscr); break;
        case OP_VSUB:
            FLOAT_IS_READY();
            core->s[i->d] = float_subtract(core->s[i->n], core->s[i->m], &core->fpscr);
            break;
        case OP_VMUL:
            FLOAT_IS_READY();
            core->s[i->d] = float_multiply(core->s[i->n], core->s[i->m], &core->fpscr);
            break;
        case OP_VFMA:
            FLOAT_IS_READY();
            core->s[i->d] = float_multiply_add(core->s[i->d], core->s[i->n], core->s[i->m], &core->fpscr);
            break;
        case OP_VMOV: FLOAT_IS_READY(); core->s[i->d] = core->s[i->m]; break;
        case OP_VMOV_I: FLOAT_IS_READY(); core->s[i->d] = i->immediate; break;
        case OP_VMOV_TO_CORE: FLOAT_IS_READY(); r[i->d] = core->s[i->n]; break;
        case OP_VMOV_FROM_CORE: FLOAT_IS_READY(); core->s[i->n] = r[i->d]; break;
        case OP_VLDR: {
            const uint32_t address = (i->n == PC ? 0 : r[i->n]) + i->immediate;
            const bool is_plain = i->words == 1 && address % 4 == 0;
            const uint8_t *bytes = is_plain ? plain_bytes(machine, address, 4) : NULL;
            FLOAT_IS_READY();
            if (bytes)
                memcpy(&core->s[i->d], bytes, 4);
            else
                ELSEWHERE(load_floats(machine, i));
            if (WAITS)
                cycles += transfer_wait(machine, node, address, cycles);
            break;
        }
        case OP_VSTR: {
            const uint32_t address = r[i->n] + i->immediate;
            const bool is_plain = i->words == 1 && address % 4 == 0;
            FLOAT_IS_READY(); /* saving state may close the page */
            uint8_t *bytes = is_plain ? writable_bytes(machine, address, 4) : NULL;
            if (bytes)
                memcpy(bytes, &core->s[i->d], 4);
            else
                ELSEWHERE(store_floats(machine, i));
            if (WAITS)
                cycles += transfer_wait(machine, node, address, cycles);
            break;
        }
        case OP_VLDM: FLOAT_IS_READY(); TRANSFER(load_floats(machine, i)); break;
        case OP_VSTM: FLOAT_IS_READY(); TRANSFER(store_floats(machine, i)); break;
        default:
            if (i->uses_fpu) {
                FLOAT_IS_READY();
                compute_float(core, i);
            } else {
                compute_rest(core, i);
            }
            break;
        }

        /* The instruction is complete, and execution continues after it. */
        if (node->moves_stack)
            follow_stack(machine, node, node->address + i->size);
        node->runs++;
        cycles += node->cost;
        instructions++;
        from = node;
        node = from->next;
        if (!node) {
            uint8_t it_state = i->operation == OP_IT ? (uint8_t)i->immediate : advance_it_state(from->it_state);
            node = follow_behind(machine, from, &from->next, it_state, from->next_state);
            if (!node) {
                machine->history.previous = from->address;
                stand_at(machine, from->address + i->size, it_state, from->next_state);
                goto over;
            }
        }
        if (outcome != RAN)
            break;
        continue;

    skips:
        node->skips++;
        cycles += node->skipped_cost;
        instructions++;
        from = node;
        node = from->skipped;
        if (!node) {
            uint8_t it_state = advance_it_state(from->it_state);
            node = follow_behind(machine, from, &from->skipped, it_state, from->skipped_state);
            if (!node) {
                machine->history.previous = from->address;
                stand_at(machine, from->address + i->size, it_state, from->skipped_state);
                goto over;
            }
        }
        continue;

    jumps: /* with interworking: bit 0 of the target must be set */
        if (node->moves_stack)
            follow_stack(machine, node, target);
        if (target >= 0xF0000000u && (core->exception || target >= 0xFF000000u)) {
            node->jumps++;
            machine->history.exc_return = target;
            outcome = LEFT;
            cycles += node->taken_cost;
            instructions++;
            machine->history.previous = node->address;
            stand_at(machine, node->address + i->size, 0, node->taken_state);
            goto over;
        }
    jumps_within:
        forget_fetched_word(machine, cycles);
        if (node->taken && (node->jump | 1) == target) {
            from = node;
            cycles += node->taken_cost;
            instructions++;
            node = node->taken;
            goto jumped;
        }
        goto arrives;
    branches:
        forget_fetched_word(machine, cycles);
        if (node->taken) {
            from = node;
            cycles += node->taken_cost;
            instructions++;
            node = node->taken;
            goto jumped;
        }
        target = i->immediate | 1;
    arrives: {
        bool links = !machine->profiles || profile_follow(machine, node, target & ~1u, true);
        struct node *taken = target & 1 ? follow(machine, target & ~1u, 0, node->taken_state) : NULL;
        from = node;
        cycles += node->taken_cost;
        instructions++;
        if (!taken) {
            node->jumps++;
            core->thumb = target & 1;
            machine->history.previous = machine->history.jumped_from = node->address;
            machine->history.jumped_at = instructions;
            stand_at(machine, target & ~1u, 0, node->taken_state);
            goto over;
        }
        if (links) {
            node->taken = taken;
            node->jump = target & ~1u;
        }
        node = taken;
    }
    jumped:
        from->jumps++;
        machine->history.jumped_from = from->address;
        machine->history.jumped_at = instructions;
        if (instructions >= core->instruction_limit)
            break;
    } while (cycles < horizon);
    goto stands;

faulted:
    outcome = FAULTED;
stands:
    stand_at(machine, node->address, node->it_state, node->state);
over:
    core->cycles = cycles;
    core->instructions = instructions;
    return outcome;
}
