/* Registers that the core stores in parts: xPSR, the two stack pointers, CONTROL. References are to DDI 0403E. */
#include "registers.h"

/* Positions of the parts of xPSR (B1.4.2). */
enum {
    N_BIT = 31, Z_BIT = 30, C_BIT = 29, V_BIT = 28, Q_BIT = 27, IT_LOW_BIT = 25, GE_BIT = 16, IT_HIGH_BIT = 10,
    BASELINE_EXCEPTION = 0x3F, /* ARMv6-M has six bits of IPSR, and neither Q nor GE nor IT */
};

void set_mode(struct core *core, uint32_t exception, uint32_t control)
{
    bool used_process_stack = uses_process_stack(core);
    core->exception = exception;
    core->control = control;
    if (uses_process_stack(core) != used_process_stack) {
        uint32_t stack = core->r[13];
        core->r[13] = core->other_stack;
        core->other_stack = stack;
    }
}

static uint32_t it_bits(uint32_t it_state)
{
    return (it_state & 3) << IT_LOW_BIT | (it_state >> 2 & 0x3F) << IT_HIGH_BIT;
}

uint32_t machine_xpsr(struct machine *machine)
{
    const struct core *core = &machine->core;
    uint32_t flags = (core->negative >> 31) << N_BIT | (uint32_t)(core->zero == 0) << Z_BIT | (core->carry & 1) << C_BIT
        | (core->overflow & 1) << V_BIT;
    uint32_t value = flags | (core->thumb ? XPSR_THUMB : 0) | (core->exception & XPSR_EXCEPTION);
    if (machine->baseline)
        return value;
    return value | (core->saturated & 1) << Q_BIT | (core->ge & 0xF) << GE_BIT | it_bits(core->it_state);
}

void machine_set_xpsr(struct machine *machine, uint32_t value)
{
    struct core *core = &machine->core;
    bool baseline = machine->baseline;
    core->negative = value;
    core->zero = value >> Z_BIT & 1 ? 0 : 1;
    core->carry = value >> C_BIT & 1;
    core->overflow = value >> V_BIT & 1;
    core->saturated = baseline ? 0 : value >> Q_BIT & 1;
    core->ge = baseline ? 0 : value >> GE_BIT & 0xF;
    core->it_state = baseline ? 0 : (value >> IT_LOW_BIT & 3) | (value >> IT_HIGH_BIT & 0x3F) << 2;
    core->thumb = (value & XPSR_THUMB) != 0;
    set_mode(core, value & (baseline ? BASELINE_EXCEPTION : XPSR_EXCEPTION), core->control);
}

uint32_t machine_stack_pointer(struct machine *machine, bool process)
{
    const struct core *core = &machine->core;
    return uses_process_stack(core) == process ? core->r[13] : core->other_stack;
}

/* Bits 0 and 1 of a stack pointer are always zero (B1.4.7). */
void machine_set_stack_pointer(struct machine *machine, bool process, uint32_t value)
{
    struct core *core = &machine->core;
    uint32_t *pointer = uses_process_stack(core) == process ? &core->r[13] : &core->other_stack;
    *pointer = value & ~3u;
}

/* Handler mode does not change SPSEL (B1.4.4). ARMv6-M without the unprivileged extension has only SPSEL. */
void machine_set_control(struct machine *machine, uint32_t value)
{
    struct core *core = &machine->core;
    uint32_t writable = machine->baseline ? CONTROL_SPSEL : CONTROL_NPRIV | CONTROL_SPSEL | CONTROL_FPCA;
    if (core->exception != EXCEPTION_NONE)
        writable &= ~(uint32_t)CONTROL_SPSEL;
    set_mode(core, core->exception, (core->control & ~writable) | (value & writable));
}
