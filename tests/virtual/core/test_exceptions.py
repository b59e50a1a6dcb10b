"""Exceptions of the core in C, where the model does not look: ARMv6-M, and numbers out of range."""

from __future__ import annotations

import pytest

from .exceptions_in_c import (
    FIRST_INTERRUPT,
    FPCA,
    HARD_FAULT,
    IDLE,
    INTERRUPTS,
    NMI,
    NPRIV,
    PENDSV,
    RAM_END,
    SPSEL,
    SYSTICK,
    THUMB,
    Machine,
)

TO_HANDLER = 0xFFFFFFF1
FLOATS_TO_HANDLER, FLOATS_TO_THREAD = 0xFFFFFFE1, 0xFFFFFFE9
A = FIRST_INTERRUPT


@pytest.fixture
def machine() -> Machine:
    """A core in thread mode with a vector for every exception."""
    return Machine()


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


@pytest.mark.parametrize("change", ["pend", "enable", "priority", "return"])
def test_whatever_may_make_an_exception_deliverable_has_the_core_look(machine: Machine, change: str) -> None:
    machine.enter(SYSTICK)
    machine.pointer.must_check = False
    if change == "pend":
        machine.call("machine_pend", A)
    elif change == "enable":
        machine.call("machine_set_enabled", 0, True)
    elif change == "priority":
        machine.call("machine_set_priority", A, 0x20)
    else:
        assert machine.leave()
    assert machine.pointer.must_check


def test_entries_and_returns_empty_the_pipeline_and_clear_the_monitor_and_are_events(machine: Machine) -> None:
    def dirty() -> None:
        machine.pointer.history.pipeline.fpu_busy = 9
        machine.pointer.history.exclusive, machine.core.event = True, False

    def is_clean() -> bool:
        history = machine.pointer.history
        return not history.pipeline.fpu_busy and not history.exclusive and machine.core.event

    dirty()
    machine.enter(SYSTICK)
    assert is_clean()
    dirty()
    assert machine.leave()
    assert is_clean()


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


@pytest.mark.parametrize("place", [0xFFFFFFF8, RAM_END - 8, 0x40000000, 0x100])
def test_state_whose_frame_is_gone_is_dropped(machine: Machine, place: int) -> None:
    flash, ram = bytes(machine.flash), bytes(machine.ram)
    machine.core.lazy_frame = place
    machine.call("machine_save_floats")
    assert machine.core.lazy_frame == 0
    assert (bytes(machine.flash), bytes(machine.ram)) == (flash, ram)


def test_only_the_first_fault_of_an_instruction_counts(machine: Machine) -> None:
    machine.call("note_fault", 3, 1, 0x801, 0x50000000, 0, 4)
    machine.call("note_fault", 6, 8, 0x802, 0, 0, 0)
    assert machine.fault == ("DATA_BUS", "READ_UNMAPPED")
    assert machine.core.fault.place == 0x800


def test_xpsr_is_read_as_it_was_written(machine: Machine) -> None:
    for bit in [*range(9), *range(10, 20), *range(24, 32)]:
        machine.call("machine_set_xpsr", 1 << bit)
        assert machine.call("machine_xpsr") == 1 << bit
    machine.call("machine_set_xpsr", 0xFFFFFFFF)
    assert machine.call("machine_xpsr") == 0xFF0FFDFF


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
