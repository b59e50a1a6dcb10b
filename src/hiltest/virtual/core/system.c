#include "execute.h"
#include "registers.h"

/* Numbers of special registers (SYSm). */
enum {
    SYS_XPSR_LAST = 7, SYS_MSP = 8, SYS_PSP = 9, SYS_PRIMASK = 16, SYS_BASEPRI = 17, SYS_BASEPRI_MAX = 18,
    SYS_FAULTMASK = 19, SYS_CONTROL = 20,
    WITH_IPSR = 1, WITH_EPSR = 2, WITHOUT_APSR = 4,
};
static const uint32_t APSR_BITS = 0xF80F0000u;

static bool is_privileged(const struct core *core) { return core->exception != 0 || !(core->control & CONTROL_NPRIV); }

uint32_t read_special(struct machine *machine, uint32_t number)
{
    const struct core *core = &machine->core;
    if (number <= SYS_XPSR_LAST) {
        uint32_t value = number & WITHOUT_APSR ? 0 : machine_xpsr(machine) & APSR_BITS; /* EPSR reads as zero */
        return number & WITH_IPSR && is_privileged(core) ? value | core->exception : value;
    }
    if (number == SYS_CONTROL)
        return core->control;
    if (!is_privileged(core))
        return 0;
    switch (number) {
    case SYS_MSP: case SYS_PSP: return machine_stack_pointer(machine, number == SYS_PSP);
    case SYS_PRIMASK: return core->primask;
    case SYS_BASEPRI: case SYS_BASEPRI_MAX: return core->basepri;
    case SYS_FAULTMASK: return core->faultmask;
    default: return 0;
    }
}

static void write_flags(struct core *core, uint32_t mask, uint32_t value)
{
    if (mask & 2) {
        core->negative = value;
        core->zero = ~value >> 30 & 1;
        core->carry = value >> 29 & 1;
        core->overflow = value >> 28 & 1;
        core->saturated = value >> 27 & 1;
    }
    if (mask & 1)
        core->ge = value >> 16 & 0xF;
}

/* BASEPRI_MAX only raises the priority: 0 and less urgent values have no effect. */
static void raise_base_priority(struct core *core, uint32_t value)
{
    if (value && (core->basepri == 0 || value < core->basepri))
        core->basepri = value;
}

/* ARMv6-M has no FAULTMASK; NMI and HardFault cannot set it. */
static void set_fault_mask(struct machine *machine, uint32_t value)
{
    if (!machine->baseline && (!value || machine_execution_priority(machine, PRIORITY_IDLE) > -1))
        machine->core.faultmask = value;
}

static void set_primask(struct core *core, uint32_t value)
{
    const int64_t awake = core->cycles - core->idle_cycles; /* a pending interrupt ends a masked sleep */
    if (value && !core->primask)
        core->masked_since = awake;
    if (!value && core->primask && awake - core->masked_since > core->longest_masked)
        core->longest_masked = awake - core->masked_since;
    core->primask = value;
}

void write_special(struct machine *machine, uint32_t number, uint32_t mask, uint32_t value)
{
    struct core *core = &machine->core;
    if (number < WITHOUT_APSR)
        write_flags(core, mask, value);
    if (number <= SYS_XPSR_LAST || !is_privileged(core))
        return;
    uint32_t priority = value & core->priority_mask;
    switch (number) {
    case SYS_MSP: case SYS_PSP: machine_set_stack_pointer(machine, number == SYS_PSP, value); return;
    case SYS_PRIMASK: set_primask(core, value & 1); break;
    case SYS_BASEPRI:
        if (!machine->baseline)
            core->basepri = priority;
        break;
    case SYS_BASEPRI_MAX:
        if (!machine->baseline)
            raise_base_priority(core, priority);
        break;
    case SYS_FAULTMASK: set_fault_mask(machine, value & 1); break;
    case SYS_CONTROL: machine_set_control(machine, value); break;
    default: return;
    }
    machine->must_check = true;
}

void change_masks(struct machine *machine, const struct instruction *instruction)
{
    struct core *core = &machine->core;
    if (!is_privileged(core))
        return;
    uint32_t value = instruction->immediate & 1;
    if (instruction->amount & 2)
        set_primask(core, value);
    if (instruction->amount & 1)
        set_fault_mask(machine, value);
    machine->must_check = true;
}
