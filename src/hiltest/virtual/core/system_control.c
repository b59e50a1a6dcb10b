/* The System Control Space: registers of the NVIC and of the SCB (DDI 0403E, B3.2 and B3.4). SysTick has a file of its
 * own, and answers before this page. */
#include "devices.h"
#include "registers.h"

enum { ICTR = 0x004, ISER = 0x100, ICER = 0x180, ISPR = 0x200, ICPR = 0x280, IABR = 0x300, IABR_END = 0x380 };
enum { IPR = 0x400, CPUID = 0xD00, ICSR = 0xD04, VTOR = 0xD08, AIRCR = 0xD0C, SCR = 0xD10, CCR = 0xD14 };
enum { SHPR = 0xD18, SHPR_END = 0xD24, SHCSR = 0xD24, CFSR = 0xD28, HFSR = 0xD2C, MMFAR = 0xD34, BFAR = 0xD38 };
enum { CPACR = 0xD88, DEMCR = 0xDFC, STIR = 0xF00, FPCCR = 0xF34, FPCAR = 0xF38, FPDSCR = 0xF3C };
enum { GROUP_BITS = 0xF80, GROUP_OFFSET = 0x7F }; /* parts of an offset among registers with a bit per interrupt */

enum { ICSR_ISRPENDING = 1 << 22, ICSR_RETTOBASE = 1 << 11, ICSR_VECTPENDING_SHIFT = 12 };
enum { AIRCR_SYSRESETREQ = 4, AIRCR_KEY = 0x05FA, AIRCR_PRIGROUP_SHIFT = 8, STIR_INTID = 0x1FF };
enum { SCR_SLEEPONEXIT = 2, SCR_SLEEPDEEP = 4, SCR_SEVONPEND = 16 };
enum { CCR_NONBASETHRDENA = 1, CCR_UNALIGN_TRP = 8, CCR_DIV_0_TRP = 16, CCR_STKALIGN = 512 };
enum { VTOR_RESERVED = 0x7F, FPCCR_LSPACT = 1, DEMCR_TRCENA = 1 << 24, CPACR_FPU = 0xF << 20 };
static const uint32_t SYSTEM_CONTROL = 0xE000E000, CORTEX_M4 = 0x410FC241 /* r0p1 */, CORTEX_M0 = 0x410CC200;
static const uint32_t AIRCR_READ_KEY = 0xFA050000;

struct system_control {
    struct device device;
    struct machine_system_control connections;
    uint32_t stored[PAGE_BYTES / 4]; /* registers that store writes */
};

/* Exceptions with bits in a register: in ICSR bits that set and, below them, clear; the others are in SHCSR. */
struct exception_bit {
    uint32_t bit;
    int32_t exception;
};
enum { ICSR_BITS = 3, ENABLE_BITS = 3, ACTIVE_BITS = 6, PENDED_BITS = 4 };
static const struct exception_bit PENDING[ICSR_BITS] = {
    {31, EXCEPTION_NMI}, {28, EXCEPTION_PENDSV}, {26, EXCEPTION_SYSTICK}};
static const struct exception_bit FAULT_ENABLED[ENABLE_BITS] = {
    {16, EXCEPTION_MEM_MANAGE}, {17, EXCEPTION_BUS_FAULT}, {18, EXCEPTION_USAGE_FAULT}};
static const struct exception_bit FAULT_ACTIVE[ACTIVE_BITS] = {
    {0, EXCEPTION_MEM_MANAGE}, {1, EXCEPTION_BUS_FAULT}, {3, EXCEPTION_USAGE_FAULT}, {7, EXCEPTION_SVCALL},
    {10, EXCEPTION_PENDSV}, {11, EXCEPTION_SYSTICK}};
static const struct exception_bit FAULT_PENDED[PENDED_BITS] = {
    {12, EXCEPTION_USAGE_FAULT}, {13, EXCEPTION_MEM_MANAGE}, {14, EXCEPTION_BUS_FAULT}, {15, EXCEPTION_SVCALL}};

/* Return the register bits of those exceptions that are in the first word of a set. */
static uint32_t bits_of(const struct exception_bit *bits, int32_t count, uint32_t set)
{
    uint32_t word = 0;
    for (int32_t i = 0; i < count; i++)
        word |= (set >> bits[i].exception & 1) << bits[i].bit;
    return word;
}

/* -- reads -------------------------------------------------------------------------------------------------------- */

/* Bits of 32 interrupts of a set from a multiple of 32 on; the set begins with the 16 system exceptions. */
static uint32_t interrupts_of(const uint32_t set[EXCEPTION_WORDS], uint32_t first)
{
    uint32_t word = first / 32;
    uint32_t low = word < EXCEPTION_WORDS ? set[word] >> FIRST_INTERRUPT : 0;
    return word + 1 < EXCEPTION_WORDS ? low | set[word + 1] << FIRST_INTERRUPT : low;
}

static uint32_t read_interrupts(const struct core *core, uint32_t offset)
{
    uint32_t first = 8 * (offset & GROUP_OFFSET);
    switch (offset & GROUP_BITS) {
    case ISER: case ICER: return interrupts_of(core->enabled, first);
    case ISPR: case ICPR: return interrupts_of(core->pending, first);
    default: return interrupts_of(core->is_active, first);
    }
}

static bool has_pending_interrupt(const struct core *core)
{
    uint32_t pending = core->pending[0] >> FIRST_INTERRUPT;
    for (int32_t word = 1; word < EXCEPTION_WORDS; word++)
        pending |= core->pending[word];
    return pending != 0;
}

static uint32_t read_interrupt_control(struct machine *machine)
{
    const struct core *core = &machine->core;
    uint32_t word = (uint32_t)last_active(core) | bits_of(PENDING, ICSR_BITS, core->pending[0]);
    if (active_exceptions(core) <= 1)
        word |= ICSR_RETTOBASE;
    if (has_pending_interrupt(core))
        word |= ICSR_ISRPENDING;
    return word | (uint32_t)machine_most_urgent(machine, PRIORITY_IDLE) << ICSR_VECTPENDING_SHIFT;
}

static uint32_t read_priorities(const struct core *core, uint32_t first)
{
    uint32_t word = 0;
    for (uint32_t i = 0; i < 4; i++)
        word |= (uint32_t)core->priority[first + i] << 8 * i;
    return word;
}

static uint32_t read_fault_control(const struct core *core)
{
    return bits_of(FAULT_ENABLED, ENABLE_BITS, core->fault_enabled)
        | bits_of(FAULT_ACTIVE, ACTIVE_BITS, core->is_active[0])
        | bits_of(FAULT_PENDED, PENDED_BITS, core->pending[0]);
}

static bool is_interrupt_priority(const struct core *core, uint32_t offset)
{
    return offset >= IPR && offset < IPR + (uint32_t)core->interrupts;
}

static bool is_system_priority(uint32_t offset) { return offset >= SHPR && offset < SHPR_END; }

static uint32_t read_word(struct machine *machine, struct device *device, uint32_t offset)
{
    const struct system_control *control = (const struct system_control *)device;
    const struct core *core = &machine->core;
    if (offset >= ISER && offset < IABR_END)
        return read_interrupts(core, offset);
    if (is_interrupt_priority(core, offset))
        return read_priorities(core, FIRST_INTERRUPT + offset - IPR);
    if (is_system_priority(offset))
        return read_priorities(core, EXCEPTION_MEM_MANAGE + offset - SHPR);
    switch (offset) {
    case ICTR: return 2; /* registers for 96 interrupts */
    case CPUID: return machine->baseline ? CORTEX_M0 : CORTEX_M4;
    case ICSR: return read_interrupt_control(machine);
    case VTOR: return core->vector_table;
    case AIRCR: return AIRCR_READ_KEY | core->priority_grouping << AIRCR_PRIGROUP_SHIFT;
    case SHCSR: return read_fault_control(core);
    case CFSR: return core->cfsr;
    case HFSR: return core->hfsr;
    case MMFAR: return 0; /* no MPU forbids an access */
    case BFAR: return core->bfar;
    case FPCCR: return core->floating_control | (core->lazy_frame ? FPCCR_LSPACT : 0);
    case FPCAR: return core->lazy_frame;
    case FPDSCR: return core->floating_default;
    default: return control->stored[offset / 4];
    }
}

/* -- writes ------------------------------------------------------------------------------------------------------- */

/* Ones change their interrupts, and zeros have no effect. */
static void write_interrupts(struct machine *machine, uint32_t offset, uint32_t value)
{
    int32_t interrupt = (int32_t)(8 * (offset & GROUP_OFFSET));
    for (; value && interrupt < machine->core.interrupts; interrupt++, value >>= 1) {
        if (!(value & 1))
            continue;
        switch (offset & GROUP_BITS) {
        case ISER: machine_set_enabled(machine, interrupt, true); break;
        case ICER: machine_set_enabled(machine, interrupt, false); break;
        case ISPR: machine_pend(machine, FIRST_INTERRUPT + interrupt); break;
        default: machine_unpend(machine, FIRST_INTERRUPT + interrupt); break;
        }
    }
}

static void write_priorities(struct machine *machine, uint32_t first, uint32_t size, uint32_t value)
{
    for (uint32_t i = 0; i < size; i++)
        machine_set_priority(machine, (int32_t)(first + i), value >> 8 * i & 0xFF);
}

static void write_interrupt_control(struct machine *machine, uint32_t value)
{
    for (int32_t i = 0; i < ICSR_BITS; i++) {
        if (value >> PENDING[i].bit & 1)
            machine_pend(machine, PENDING[i].exception);
        else if (PENDING[i].exception != EXCEPTION_NMI && value >> (PENDING[i].bit - 1) & 1)
            machine_unpend(machine, PENDING[i].exception);
    }
}

static void write_fault_control(struct machine *machine, uint32_t value)
{
    machine->core.fault_enabled = 0;
    for (int32_t i = 0; i < ENABLE_BITS; i++)
        machine->core.fault_enabled |= (value >> FAULT_ENABLED[i].bit & 1) << FAULT_ENABLED[i].exception;
    for (int32_t i = 0; i < PENDED_BITS; i++) {
        if (value >> FAULT_PENDED[i].bit & 1)
            machine_pend(machine, FAULT_PENDED[i].exception);
        else
            machine_unpend(machine, FAULT_PENDED[i].exception);
    }
}

static void write_reset_control(struct machine *machine, const struct system_control *control, uint32_t value)
{
    if (value >> 16 != AIRCR_KEY)
        return;
    machine->core.priority_grouping = value >> AIRCR_PRIGROUP_SHIFT & 7;
    machine->must_check = true;
    if (value & AIRCR_SYSRESETREQ)
        control->connections.request_reset(control->connections.context);
}

/* Write a register that stores writes and has a further effect. */
static void write_stored(struct machine *machine, struct system_control *control, uint32_t offset, uint32_t value)
{
    struct core *core = &machine->core;
    control->stored[offset / 4] = value;
    switch (offset) {
    case CPACR: machine_set_fpu(machine, (value & CPACR_FPU) == CPACR_FPU); break;
    case SCR:
        core->sleeps_on_exit = value & SCR_SLEEPONEXIT;
        core->sleeps_deeply = value & SCR_SLEEPDEEP;
        core->sends_on_pend = value & SCR_SEVONPEND;
        break;
    case CCR:
        core->base_thread_enabled = value & CCR_NONBASETHRDENA;
        core->divide_traps = value & CCR_DIV_0_TRP;
        core->unaligned_traps = value & CCR_UNALIGN_TRP;
        break;
    case DEMCR: enable_trace(machine, value & DEMCR_TRCENA); break;
    default: break;
    }
}

/* Ones clear the bits of CFSR and HFSR. */
static void write_word(struct machine *machine, struct system_control *control, uint32_t offset, uint32_t value)
{
    struct core *core = &machine->core;
    switch (offset) {
    case VTOR: core->vector_table = value & ~(uint32_t)VTOR_RESERVED; break;
    case AIRCR: write_reset_control(machine, control, value); break;
    case SHCSR: write_fault_control(machine, value); break;
    case CFSR: core->cfsr &= ~value; break;
    case HFSR: core->hfsr &= ~value; break;
    case MMFAR: break;
    case BFAR: core->bfar = value; break;
    case FPCCR: core->floating_control = value & ~(uint32_t)FPCCR_LSPACT; break;
    case FPDSCR: core->floating_default = value & FPDSCR_BITS; break;
    default: write_stored(machine, control, offset, value); break;
    }
}

/* Write a part of a word: the rest is unchanged, and zero in registers in which zeros change nothing. */
static void write_part(
    struct machine *machine, struct system_control *control, uint32_t offset, uint32_t size, uint32_t value)
{
    uint32_t word = offset & ~3u, shift = 8 * (offset & 3), mask = UINT32_MAX >> 8 * (4 - size) << shift;
    bool clears = word == CFSR || word == HFSR;
    uint32_t rest = size == 4 || clears ? 0 : read_word(machine, &control->device, word) & ~mask;
    write_word(machine, control, word, rest | value << shift);
}

static void write_register(
    struct machine *machine, struct device *device, uint32_t offset, uint32_t size, uint32_t value)
{
    struct system_control *control = (struct system_control *)device;
    if (offset >= ISER && offset < IABR)
        write_interrupts(machine, offset, value);
    else if (is_interrupt_priority(&machine->core, offset))
        write_priorities(machine, FIRST_INTERRUPT + offset - IPR, size, value);
    else if (is_system_priority(offset))
        write_priorities(machine, EXCEPTION_MEM_MANAGE + offset - SHPR, size, value);
    else if (offset == ICSR)
        write_interrupt_control(machine, value);
    else if (offset == STIR)
        machine_pend(machine, FIRST_INTERRUPT + (int32_t)(value & STIR_INTID));
    else
        write_part(machine, control, offset, size, value);
}

/* Other state that the registers show is reset with the processor, see machine_reset. */
static void reset(struct machine *machine, struct device *device)
{
    struct system_control *control = (struct system_control *)device;
    for (int32_t i = 0; i < PAGE_BYTES / 4; i++)
        control->stored[i] = 0;
    control->stored[CCR / 4] = CCR_STKALIGN;
    machine_set_fpu(machine, false);
    machine->core.sleeps_deeply = false;
}

bool machine_add_system_control(struct machine *machine, struct machine_system_control connections)
{
    const struct system_control control = {
        .device = {
            .base = SYSTEM_CONTROL, .bytes = PAGE_BYTES, .read = read_by_words, .read_word = read_word,
            .write = write_register, .reset = reset},
        .connections = connections};
    return add_device(machine, &control.device, sizeof control);
}
