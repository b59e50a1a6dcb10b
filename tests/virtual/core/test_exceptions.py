"""Exceptions of the core in C, as the architecture has them (DDI 0403E, B1.5)."""

from __future__ import annotations

import pytest

from .exceptions_in_c import (
    ASPEN,
    BUS_FAULT,
    FIRST_INTERRUPT,
    FLASH_BYTES,
    FPCA,
    HANDLERS,
    HARD_FAULT,
    IDLE,
    INTERRUPTS,
    LSPEN,
    MEM_MANAGE,
    NMI,
    NPRIV,
    PENDSV,
    PRICES,
    RAM,
    RAM_END,
    SPSEL,
    SVCALL,
    SYSTICK,
    THUMB,
    USAGE_FAULT,
    Machine,
)

TO_HANDLER, TO_THREAD, TO_PROCESS = 0xFFFFFFF1, 0xFFFFFFF9, 0xFFFFFFFD
FLOATS_TO_HANDLER, FLOATS_TO_THREAD, FLOATS_TO_PROCESS = 0xFFFFFFE1, 0xFFFFFFE9, 0xFFFFFFED
BASIC, EXTENDED = 32, 104  # bytes of a frame
ENTRY, RETURN, CHAIN, FRAME = PRICES.values()
A, B, C = FIRST_INTERRUPT, FIRST_INTERRUPT + 1, FIRST_INTERRUPT + 40  # external interrupts
FORCED = 1 << 30  # HFSR


@pytest.fixture
def machine() -> Machine:
    """A core in thread mode with a vector for every exception."""
    return Machine()


def test_an_entry_stacks_eight_words_and_begins_the_handler(machine: Machine) -> None:
    core = machine.core
    for number in range(13):
        core.r[number] = 100 + number
    core.r[14] = 0xABCD
    core.carry, core.it_state, stack = 1, 0xA6, core.r[13]
    machine.enter(SYSTICK)
    assert machine.read_words(stack - BASIC, 8) == [
        100, 101, 102, 103, 112, 0xABCD, 0x800, 1 << 29 | THUMB | (0xA6 & 3) << 25 | (0xA6 >> 2) << 10,
    ]  # fmt: skip
    assert core.r[13] == stack - BASIC
    assert (core.r[14], core.r[15]) == (TO_THREAD, HANDLERS + 16 * SYSTICK)
    assert (core.it_state, core.thumb, core.carry) == (0, 1, 1)
    assert machine.active == [SYSTICK]
    assert machine.members("taken") == {SYSTICK}
    assert machine.members("pending") == set()


def test_a_return_brings_back_what_was_interrupted(machine: Machine) -> None:
    core = machine.core
    core.r[0], core.r[12], core.r[14] = 1, 2, 3
    core.it_state, core.overflow, core.ge, stack = 0xA6, 1, 0xC, core.r[13]
    machine.enter(SYSTICK)
    core.r[0] = core.r[12] = core.overflow = core.ge = 77
    assert machine.leave()
    assert (core.r[0], core.r[12], core.r[13], core.r[14], core.r[15]) == (1, 2, stack, 3, 0x800)
    assert (core.it_state, core.overflow, core.ge, core.exception) == (0xA6, 1, 0xC, 0)
    assert machine.active == []


@pytest.mark.parametrize("misplaced", [0, 4])
def test_a_frame_begins_at_a_multiple_of_eight_and_its_xpsr_tells_that_it_was_moved(
    machine: Machine, misplaced: int
) -> None:
    core = machine.core
    core.r[13] -= misplaced
    stack = core.r[13]
    machine.enter(PENDSV)
    assert core.r[13] % 8 == 0
    assert machine.read_words(core.r[13], 8)[7] >> 9 & 1 == misplaced // 4
    assert machine.leave()
    assert core.r[13] == stack
    assert machine.call("machine_xpsr") & 1 << 9 == 0


@pytest.mark.parametrize("code", [-26, -24, -8, 0, 6, 8])
def test_a_frame_that_is_written_over_code_has_the_core_decode_that_again(machine: Machine, code: int) -> None:
    page = 0x20000000
    machine.call("mark_code", page + code, 2)
    machine.core.r[13] = page + 8  # the frame lies in two pages, and both are written
    machine.core.r[12] = machine.core.r[14] = 0x11111111
    machine.pointer.code_changed = False
    machine.enter(PENDSV)
    assert machine.read_words(page - 24, 8) == [0, 0, 0, 0, 0x11111111, 0x11111111, 0x800, THUMB]
    assert machine.pointer.code_changed == (-24 <= code < 8)


def test_thread_mode_on_the_process_stack_is_stacked_there_and_its_handler_uses_the_main_one(machine: Machine) -> None:
    core = machine.core
    core.control = SPSEL
    process, main = core.r[13], core.other_stack
    machine.enter(SVCALL)
    assert (core.r[13], core.other_stack, core.control, core.r[14]) == (main, process - BASIC, 0, TO_PROCESS)
    assert machine.leave()
    assert (core.r[13], core.other_stack, core.control) == (process, main, SPSEL)


def test_a_handler_runs_privileged_and_keeps_npriv_for_thread_mode(machine: Machine) -> None:
    machine.core.control = NPRIV
    machine.enter(SVCALL)
    assert machine.core.control == NPRIV
    assert machine.leave()
    assert machine.core.control == NPRIV


def test_a_more_urgent_exception_preempts_a_handler_and_an_equal_one_does_not(machine: Machine) -> None:
    machine.call("machine_set_priority", A, 0x80)
    machine.call("machine_set_priority", B, 0x80)
    machine.call("machine_set_priority", C, 0x40)
    machine.enter(A)
    machine.pend(B)
    assert not machine.take()
    machine.enter(C)
    assert machine.core.r[14] == TO_HANDLER
    assert machine.active == [A, C]
    assert machine.leave()
    assert machine.core.exception == A


def test_of_equal_priorities_the_lower_number_comes_first(machine: Machine) -> None:
    machine.pend(C, B, A)
    assert machine.call("machine_most_urgent", IDLE) == A
    machine.call("machine_set_priority", A, 0x10)
    assert machine.call("machine_most_urgent", IDLE) == B


def test_a_sub_priority_orders_what_waits_and_preempts_nothing(machine: Machine) -> None:
    machine.core.priority_grouping = 5  # two bits pre-empt, the two below order
    machine.call("machine_set_priority", A, 0x70)
    machine.call("machine_set_priority", B, 0x60)
    machine.pend(A, B)
    assert machine.call("machine_most_urgent", IDLE) == B
    machine.enter(B)
    machine.call("machine_set_priority", A, 0x40)
    assert not machine.take()
    machine.call("machine_set_priority", A, 0x30)
    assert machine.take()


def test_only_implemented_bits_of_a_priority_count(machine: Machine) -> None:
    machine.call("machine_set_priority", A, 0x7F)
    assert machine.core.priority[A] == 0x70
    machine.call("machine_set_priority", HARD_FAULT, 0x70)
    assert machine.call("machine_preemption_priority", HARD_FAULT) == -1
    assert machine.call("machine_preemption_priority", NMI) == -2


@pytest.mark.parametrize(
    ("mask", "value", "ceiling"),
    [("primask", 1, 0), ("faultmask", 1, -1), ("basepri", 0x45, 0x40), ("basepri", 0x0F, IDLE), ("basepri", 0, IDLE)],
)
def test_masks_raise_the_priority_of_what_runs(machine: Machine, mask: str, value: int, ceiling: int) -> None:
    setattr(machine.core, mask, value)
    assert machine.call("machine_ceiling", False) == ceiling
    assert machine.call("machine_execution_priority", ceiling) == ceiling
    machine.call("machine_set_priority", A, 0x40)
    machine.pend(A)
    assert machine.take() == (ceiling == IDLE)
    machine.enter(NMI)


def test_primask_does_not_keep_wfi_asleep(machine: Machine) -> None:
    machine.core.primask = 1
    machine.pend(SYSTICK)
    assert machine.call("machine_ceiling", True) == IDLE
    assert machine.call("is_woken", False)
    assert not machine.call("is_woken", True)
    machine.core.gated = True
    assert not machine.call("is_woken", False)


def test_an_event_ends_wfe_and_is_taken(machine: Machine) -> None:
    machine.core.event = True
    assert not machine.call("is_woken", False)
    assert machine.call("is_woken", True)
    assert not machine.call("is_woken", True)


def test_with_sevonpend_an_exception_that_becomes_pending_is_an_event(machine: Machine) -> None:
    machine.core.primask = machine.core.sends_on_pend = 1
    machine.call("machine_pend", A)  # not enabled
    assert machine.call("is_woken", True)
    machine.call("machine_pend", A)  # has been pending
    assert not machine.call("is_woken", True)


def test_an_interrupt_that_is_disabled_or_does_not_exist_is_not_taken(machine: Machine) -> None:
    machine.call("machine_pend", A)
    assert not machine.take()
    last = FIRST_INTERRUPT + INTERRUPTS - 1
    for exception in (last + 1, 255, 256, 2**31 - 1, 0, -1, -(2**31)):
        machine.call("machine_pend", exception)
        machine.call("machine_unpend", exception)
        machine.call("machine_set_priority", exception, 0x10)
        machine.call("machine_preemption_priority", exception)
    for interrupt in (INTERRUPTS, 239, 240, 2**31 - 1, -1, -(2**31)):
        machine.call("machine_set_enabled", interrupt, True)
        machine.call("machine_set_line", interrupt, True)
    assert machine.members("pending") == {A}
    assert machine.members("lines") == machine.members("enabled") == set()
    machine.enter(last)


def test_a_line_that_is_still_high_pends_again_when_its_handler_returns(machine: Machine) -> None:
    machine.call("machine_set_enabled", 0, True)
    machine.call("machine_set_line", 0, True)
    machine.call("machine_unpend", A)
    assert machine.members("pending") == {A}  # the line holds it
    assert machine.take()
    machine.call("machine_set_line", 0, True)
    assert machine.members("pending") == set()  # no edge
    machine.call("machine_pend", A)
    machine.call("machine_unpend", A)
    assert machine.members("pending") == set()  # the handler runs
    assert machine.leave()
    assert machine.members("pending") == {A}
    machine.enter(A)
    machine.call("machine_set_line", 0, False)
    assert machine.leave()
    assert machine.members("pending") == set()


@pytest.mark.parametrize("change", ["pend", "enable", "priority", "return"])
def test_whatever_may_make_an_exception_deliverable_has_the_core_look(machine: Machine, change: str) -> None:
    machine.enter(SYSTICK)
    machine.pointer.looks = False
    if change == "pend":
        machine.call("machine_pend", A)
    elif change == "enable":
        machine.call("machine_set_enabled", 0, True)
    elif change == "priority":
        machine.call("machine_set_priority", A, 0x20)
    else:
        assert machine.leave()
    assert machine.pointer.looks


def test_entries_and_returns_empty_the_pipeline_and_clear_the_monitor_and_are_events(machine: Machine) -> None:
    def dirty() -> None:
        machine.pointer.pipeline.fpu_busy = 9
        machine.pointer.exclusive, machine.core.event = True, False

    def is_clean() -> bool:
        return not machine.pointer.pipeline.fpu_busy and not machine.pointer.exclusive and machine.core.event

    dirty()
    machine.enter(SYSTICK)
    assert is_clean()
    dirty()
    assert machine.leave()
    assert is_clean()


# -- cycles -----------------------------------------------------------------------------------------------------------


def test_an_entry_and_a_return_take_what_the_profile_says(machine: Machine) -> None:
    machine.enter(SYSTICK)
    assert machine.core.cycles == ENTRY
    assert machine.leave()
    assert machine.core.cycles == ENTRY + RETURN


def test_a_handler_follows_another_one_at_once(machine: Machine) -> None:
    machine.pend(A, B)
    assert machine.take()
    assert machine.leave()
    assert machine.take()
    assert machine.leave()
    assert machine.core.cycles == ENTRY + CHAIN + RETURN


def test_without_a_row_for_chains_each_handler_is_entered_anew() -> None:
    machine = Machine(prices={row: value for row, value in PRICES.items() if row != "tail_chain"})
    machine.pend(A, B)
    assert machine.take()
    assert machine.leave()
    assert machine.take()
    assert machine.leave()
    assert machine.core.cycles == 2 * (ENTRY + RETURN)


def test_a_chain_ends_where_what_waited_is_withdrawn(machine: Machine) -> None:
    machine.call("machine_pend", C)  # stays pending, but is not enabled
    machine.pend(A, B)
    assert machine.take()
    assert machine.leave()
    machine.call("machine_unpend", B)
    assert not machine.take()
    cycles = machine.core.cycles
    machine.enter(A)
    assert machine.core.cycles == cycles + ENTRY


# -- floating-point state ---------------------------------------------------------------------------------------------


@pytest.fixture
def floating(machine: Machine) -> Machine:
    """A core whose thread has used the FPU."""
    core = machine.core
    core.control, core.floating_control, core.fpscr = FPCA, ASPEN | LSPEN, 0x03000010
    for number in range(32):
        core.s[number] = 1000 + number
    return machine


FLOATING_STATE = [*range(1000, 1016), 0x03000010]


def test_a_thread_that_used_the_fpu_has_room_reserved_and_nothing_written(floating: Machine) -> None:
    core, stack = floating.core, floating.core.r[13]
    floating.enter(SYSTICK)
    assert (core.r[13], core.r[14]) == (stack - EXTENDED, FLOATS_TO_THREAD)
    assert core.lazy_frame == stack - EXTENDED + BASIC
    assert core.control == 0
    assert floating.read_words(core.lazy_frame, 17) == [0] * 17
    assert core.cycles == ENTRY
    assert floating.leave()
    assert (core.r[13], core.control, core.lazy_frame, core.cycles) == (stack, FPCA, 0, ENTRY + RETURN)


def test_a_handler_that_uses_the_fpu_saves_the_state_first_and_the_return_restores_it(floating: Machine) -> None:
    core = floating.core
    floating.enter(SYSTICK)
    frame = core.lazy_frame
    floating.call("floating_point_runs")
    floating.call("floating_point_runs")
    assert floating.read_words(frame, 18) == [*FLOATING_STATE, 0]
    assert (core.lazy_frame, core.cycles) == (0, ENTRY + FRAME)
    core.s[0] = core.s[15] = core.s[16] = core.fpscr = 7
    floating.write_words(frame + 64, [FLOATING_STATE[-1] | 0x00200F00])  # FPSCR does not have these bits
    assert floating.leave()
    assert [*core.s[0:16], core.fpscr] == FLOATING_STATE
    assert core.s[16] == 7  # the callee keeps the upper ones
    assert core.cycles == ENTRY + FRAME + RETURN + FRAME


def test_without_lazy_stacking_the_state_is_written_at_entry(floating: Machine) -> None:
    core = floating.core
    core.floating_control = ASPEN
    floating.enter(SYSTICK)
    assert (core.lazy_frame, core.cycles) == (0, ENTRY + FRAME)
    assert floating.read_words(core.r[13] + BASIC, 17) == FLOATING_STATE


def test_without_automatic_stacking_the_frame_is_a_basic_one(floating: Machine) -> None:
    floating.core.floating_control = 0
    floating.enter(SYSTICK)
    assert floating.core.r[14] == TO_THREAD


def test_handlers_of_a_chain_share_a_frame_whose_state_is_saved_once(floating: Machine) -> None:
    core = floating.core
    floating.pend(A, B)
    assert floating.take()
    floating.call("floating_point_runs")
    assert floating.leave()
    assert floating.take()
    assert (core.lazy_frame, core.cycles) == (0, ENTRY + FRAME + CHAIN)
    assert floating.leave()
    assert core.cycles == ENTRY + FRAME + CHAIN + RETURN + FRAME


@pytest.mark.parametrize("place", [0xFFFFFFF8, RAM_END - 8, 0x40000000, 0x100])
def test_state_whose_frame_is_gone_is_dropped(floating: Machine, place: int) -> None:
    flash, ram = bytes(floating.flash), bytes(floating.ram)
    floating.core.lazy_frame = place
    floating.call("floating_point_runs")
    assert floating.core.lazy_frame == 0
    assert (bytes(floating.flash), bytes(floating.ram)) == (flash, ram)


# -- what is no return ------------------------------------------------------------------------------------------------


def test_a_branch_to_an_exc_return_in_thread_mode_executes_what_must_not_be_executed(machine: Machine) -> None:
    assert not machine.leave(TO_THREAD)
    assert machine.fault == ("EXECUTE_NEVER", "RETURN_THREAD")
    assert machine.core.fault.place == 0x900


@pytest.mark.parametrize("value", [0xFFFFFFFF, 0xFFFFFFF5, 0xFFFFFFE5, 0xFFFFFF01, 0xF0000001, 0xFFFFFFF3, TO_HANDLER])
def test_a_value_that_fits_no_active_exception_is_refused_and_changes_nothing(machine: Machine, value: int) -> None:
    machine.enter(SYSTICK)
    registers = list(machine.core.r)
    assert not machine.leave(value)
    assert machine.fault == ("INVALID_RETURN", "RETURN_VALUE")
    assert machine.core.fault.value == value
    assert list(machine.core.r) == registers
    assert machine.active == [SYSTICK]


def test_only_the_first_exception_returns_to_thread_mode_unless_the_control_register_permits_more(
    machine: Machine,
) -> None:
    machine.enter(SYSTICK)
    machine.enter(NMI)
    machine.write_words(machine.core.r[13] + 28, [THUMB])
    assert not machine.leave(TO_THREAD)
    machine.core.fault.kind = 0
    machine.core.base_thread_enabled = True
    assert machine.leave(TO_THREAD)
    assert (machine.core.exception, machine.active) == (0, [SYSTICK])
    assert machine.call("machine_execution_priority", IDLE) == 0  # SysTick's
    assert not machine.leave(TO_THREAD)
    assert machine.fault == ("EXECUTE_NEVER", "RETURN_THREAD")


def test_a_frame_of_the_other_mode_is_refused(machine: Machine) -> None:
    machine.enter(SYSTICK)
    machine.write_words(machine.core.r[13] + 28, [THUMB | 11])
    assert not machine.leave()
    assert machine.fault == ("INVALID_RETURN", "RETURN_MODE")
    assert machine.core.fault.value == THUMB | 11


def test_a_stack_that_is_not_in_ram_has_no_frame(machine: Machine) -> None:
    machine.enter(SYSTICK)
    machine.core.r[13] = 0x400
    assert not machine.leave()
    assert machine.fault == ("UNSTACKING", "STACK_FRAME")
    assert machine.core.fault.address == 0x400


def test_code_without_thumb_bit_is_returned_to_and_cannot_run(machine: Machine) -> None:
    machine.enter(SYSTICK)
    machine.write_words(machine.core.r[13] + 28, [0])
    assert not machine.leave()
    assert machine.fault == ("INVALID_STATE", "RETURN_THUMB")
    assert (machine.core.exception, machine.core.r[15], machine.core.fault.place) == (0, 0x800, 0x800)


def test_a_return_clears_faultmask_except_from_nmi(machine: Machine) -> None:
    machine.enter(SYSTICK)
    machine.core.faultmask = 1
    machine.enter(NMI)
    assert machine.leave()
    assert machine.core.faultmask == 1
    assert machine.leave()
    assert machine.core.faultmask == 0


def test_a_return_to_thread_mode_sleeps_where_firmware_has_set_sleeponexit(machine: Machine) -> None:
    machine.core.sleeps_on_exit = machine.core.waits_for_event = True
    machine.enter(SYSTICK)
    machine.enter(NMI)
    assert machine.leave()
    assert not machine.core.sleeping
    assert machine.leave()
    assert machine.core.sleeping
    assert not machine.core.waits_for_event
    machine.enter(SYSTICK)
    assert not machine.core.sleeping


# -- faults -----------------------------------------------------------------------------------------------------------

FAULTS = {
    "EXECUTE_NEVER": (MEM_MANAGE, 0), "INSTRUCTION_BUS": (BUS_FAULT, 8), "UNSTACKING": (BUS_FAULT, 11),
    "STACKING": (BUS_FAULT, 12), "UNDEFINED_INSTRUCTION": (USAGE_FAULT, 16), "INVALID_STATE": (USAGE_FAULT, 17),
    "INVALID_RETURN": (USAGE_FAULT, 18), "NO_COPROCESSOR": (USAGE_FAULT, 19), "UNALIGNED": (USAGE_FAULT, 24),
    "DIVIDE_BY_ZERO": (USAGE_FAULT, 25),
}  # fmt: skip


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_goes_to_its_handler_if_that_is_enabled_and_otherwise_to_hardfault(machine: Machine, kind: str) -> None:
    handler, bit = FAULTS[kind]
    assert machine.deliver(kind) == HARD_FAULT
    assert (machine.core.cfsr, machine.core.hfsr) == (1 << bit, FORCED)
    assert machine.leave()
    machine.core.cfsr = machine.core.hfsr = 0
    machine.core.fault_enabled = 1 << handler
    assert machine.deliver(kind) == handler
    assert (machine.core.cfsr, machine.core.hfsr) == (1 << bit, 0)


@pytest.mark.parametrize(("kind", "bit"), [("SUPERVISOR_CALL", 30), ("VECTOR_TABLE", 1), ("BREAKPOINT", 31)])
def test_some_faults_are_always_hardfaults(machine: Machine, kind: str, bit: int) -> None:
    machine.core.fault_enabled = 0x70
    assert machine.deliver(kind) == HARD_FAULT
    assert (machine.core.cfsr, machine.core.hfsr) == (0, 1 << bit)


def test_a_bus_error_of_data_tells_its_address(machine: Machine) -> None:
    machine.deliver("DATA_BUS", address=0x40001234)
    assert (machine.core.bfar, machine.core.cfsr) == (0x40001234, 1 << 9 | 1 << 15)


def test_only_the_first_fault_of_an_instruction_counts(machine: Machine) -> None:
    machine.call("note_fault", 3, 1, 0x801, 0x50000000, 0, 4)
    machine.call("note_fault", 6, 8, 0x802, 0, 0, 0)
    assert machine.fault == ("DATA_BUS", "READ_UNMAPPED")
    assert machine.core.fault.place == 0x800


def test_a_fault_that_its_handler_may_not_take_now_goes_to_hardfault(machine: Machine) -> None:
    machine.core.fault_enabled, machine.core.primask = 1 << USAGE_FAULT, 1
    assert machine.deliver("UNALIGNED") == HARD_FAULT
    assert machine.core.hfsr == FORCED


@pytest.mark.parametrize("prepare", ["in HardFault", "in NMI", "with FAULTMASK"])
def test_a_fault_where_no_handler_may_run_is_lockup(machine: Machine, prepare: str) -> None:
    if prepare == "in HardFault":
        assert machine.deliver("UNALIGNED") == HARD_FAULT
    elif prepare == "in NMI":
        machine.enter(NMI)
    else:
        machine.core.faultmask = 1
    machine.core.fault_enabled = 0x70
    active = machine.active
    assert machine.deliver("UNALIGNED") == 0
    assert machine.core.fault.kind == 0
    assert machine.active == active


def test_an_exception_without_room_for_its_frame_is_entered_and_its_fault_is_delivered_next(machine: Machine) -> None:
    core = machine.core
    core.r[13] = RAM + 16
    core.fault_enabled = 1 << BUS_FAULT
    machine.call("machine_set_priority", SYSTICK, 0x10)
    machine.enter(SYSTICK)
    assert machine.fault == ("STACKING", "STACK_FRAME")
    assert core.fault.place == 0x800
    assert machine.call("machine_deliver_fault") == HARD_FAULT  # BusFault's frame has no room either
    assert core.cfsr == 1 << 12
    assert core.fault.kind == 0
    assert machine.active == [SYSTICK, BUS_FAULT, HARD_FAULT]


def test_hardfault_runs_without_a_frame(machine: Machine) -> None:
    machine.core.r[13] = RAM
    assert machine.deliver("UNALIGNED") == HARD_FAULT
    assert machine.core.cfsr == 1 << 24 | 1 << 12
    assert machine.core.r[15] == HANDLERS + 16 * HARD_FAULT


@pytest.mark.parametrize("exception", [SYSTICK, C])  # of the last table C's vector would be at address 0x60
@pytest.mark.parametrize("table", [FLASH_BYTES, RAM_END - 8, 0xFFFFFF80])
def test_a_vector_table_without_memory_is_a_hardfault_and_there_lockup(
    machine: Machine, table: int, exception: int
) -> None:
    machine.core.vector_table = table
    machine.core.r[13] = RAM  # the vector's fault comes before that of the frame
    machine.enter(exception)
    assert machine.fault == ("VECTOR_TABLE", "VECTOR_READ")
    assert machine.core.fault.address == table
    assert machine.call("machine_deliver_fault") == 0
    assert machine.core.hfsr == 2
    assert machine.core.fault.kind == 0


def test_a_vector_without_thumb_bit_is_a_usage_fault_of_a_handler_that_was_entered(machine: Machine) -> None:
    machine.write_words(4 * SYSTICK, [0x2000])
    machine.core.fault_enabled = 1 << USAGE_FAULT
    machine.call("machine_set_priority", SYSTICK, 0x10)
    machine.enter(SYSTICK)
    assert machine.fault == ("INVALID_STATE", "VECTOR_THUMB")
    assert (machine.core.fault.value, machine.core.fault.size) == (0x2000, SYSTICK)
    assert machine.call("machine_deliver_fault") == USAGE_FAULT
    frame = machine.read_words(machine.core.r[13], 8)
    assert (frame[6], frame[7] & THUMB) == (0x2000, 0)


# -- registers that have parts ----------------------------------------------------------------------------------------


def test_xpsr_is_read_as_it_was_written(machine: Machine) -> None:
    for bit in [*range(9), *range(10, 20), *range(24, 32)]:
        machine.call("machine_set_xpsr", 1 << bit)
        assert machine.call("machine_xpsr") == 1 << bit
    machine.call("machine_set_xpsr", 0xFFFFFFFF)
    assert machine.call("machine_xpsr") == 0xFF0FFDFF


def test_the_stack_pointer_follows_mode_and_control(machine: Machine) -> None:
    core = machine.core
    main, process = core.r[13], core.other_stack
    machine.call("machine_set_control", SPSEL)
    assert (core.r[13], core.other_stack) == (process, main)
    machine.call("machine_set_xpsr", THUMB | SYSTICK)
    assert (core.r[13], core.other_stack) == (main, process)
    machine.call("machine_set_control", 0)  # a handler cannot change SPSEL
    assert core.control == SPSEL
    machine.call("machine_set_stack_pointer", True, 0x20000103)
    assert machine.call("machine_stack_pointer", True) == 0x20000100
    assert machine.call("machine_stack_pointer", False) == main
    machine.call("machine_set_xpsr", THUMB)
    assert (core.r[13], core.other_stack) == (0x20000100, main)


# -- ARMv6-M ----------------------------------------------------------------------------------------------------------


def test_armv6_m_has_one_fault_handler_and_one_mask() -> None:
    machine = Machine(baseline=True)
    core = machine.core
    core.fault_enabled, core.basepri, core.faultmask = 0x70, 0x40, 1
    assert machine.call("machine_ceiling", False) == IDLE
    assert machine.deliver("UNDEFINED_INSTRUCTION") == HARD_FAULT
    assert (core.cfsr, core.hfsr) == (0, 0)
    assert machine.leave()
    core.primask = 1
    assert machine.call("machine_ceiling", False) == 0


def test_armv6_m_has_two_bits_of_priority_and_no_extended_frames() -> None:
    machine = Machine(baseline=True)
    machine.call("machine_set_priority", A, 0x7F)
    assert machine.core.priority[A] == 0x40
    machine.enter(A)
    assert not machine.leave(FLOATS_TO_THREAD)
    assert machine.fault == ("INVALID_RETURN", "RETURN_VALUE")
    machine.call("machine_set_xpsr", 0xFFFFFFFF)
    assert machine.call("machine_xpsr") == 0xF100003F
    machine.call("machine_set_xpsr", THUMB)
    machine.call("machine_set_control", NPRIV | SPSEL | FPCA)
    assert machine.core.control == SPSEL


# -- any values of the fields -----------------------------------------------------------------------------------------


def test_fields_out_of_their_range_do_no_harm(machine: Machine) -> None:
    core = machine.core
    core.priority_grouping, core.priority_mask, core.exception = 0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFF
    for count in (-5, 256, 1000):
        core.active_count = count
        core.active[255] = 0xFFFF
        machine.pend(NMI)
        machine.take()
        machine.leave(TO_HANDLER)
        machine.leave(FLOATS_TO_HANDLER)
    core.interrupts = 2**31 - 1
    machine.call("machine_pend", 255)
    core.pending[0] = 0xFFFFFFFF
    for kind in (-1, 15, 2**31 - 1):
        core.fault.kind = kind
        assert machine.call("machine_deliver_fault") == 0
        assert core.fault.kind == 0
