"""Registers that the chip has and the virtual board does not model keep what is written, and are named once."""

from __future__ import annotations

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.part.chip import mk64f12
from hiltest.virtual.peripherals.unmodelled import UnmodelledLog, UnmodelledWarning

from .conftest import SHIPPED, Build, follow, word

PDB0_ON = "*(volatile unsigned *)0x4004803C |= 1u << 22;"


def program(body: str) -> str:
    return f"unsigned before, after; void timer_init(void) {{ {body} }} int main(void) {{ timer_init(); return 0; }}"


@pytest.mark.parametrize("strict", [False, True], ids=["lenient", "strict"])
def test_the_shipped_firmware_touches_nothing_that_is_not_modelled(strict: bool) -> None:
    board = VirtualK64F(SHIPPED, strict=strict)
    board.run_until(0.3)
    assert board.unmodelled == ()


def test_a_register_is_told_once_by_name_value_and_place(build_c: Build) -> None:
    body = f"{PDB0_ON} before = WORD(0x40036008); for (int i = 8; i < 40; i++) WORD(0x40036000) = i;"
    body += "after = WORD(0x40036000); BYTE(0x40073003) = 0x80; WORD(0x400040FC) = 5;"
    board = VirtualK64F(build_c(program("WORD(0x40048034) |= 1u << 19;" + body)))
    board.run_until(0.001)
    accesses = [str(access) for access in board.unmodelled]
    assert [access.register for access in board.unmodelled] == ["PDB0_CNT", "PDB0_SC", "CMP0_SCR", "AXBS+0x0FC"]
    assert accesses[0].startswith("PDB0_CNT at 0x40036008 is not modelled; read from 0x0000")
    assert "PDB0_SC at 0x40036000 is not modelled; write of 0x00000008 from 0x" in accesses[1]
    assert "in timer_init (program.c:" in accesses[1]
    assert accesses[1].endswith(" was stored")
    assert accesses[2].startswith("CMP0_SCR at 0x40073003 is not modelled; write of 0x80 from")
    assert (word(board, "before"), word(board, "after")) == (0, 39)


def test_registers_begin_with_their_values_after_reset(build_c: Build) -> None:
    board = VirtualK64F(build_c(program(f"{PDB0_ON} before = WORD(0x40036004);")))
    follow(board, {0.001: {"before": 0xFFFF}})  # PDB0_MOD


def test_a_strict_board_faults_by_name(build_c: Build) -> None:
    board = VirtualK64F(build_c(program(f"{PDB0_ON} WORD(0x40036000) = 8;")), strict=True)
    with pytest.raises(BoardFault, match="write to PDB0_SC at 0x40036000, which is not modelled") as caught:
        board.run_until(0.001)
    assert caught.value.function == "timer_init"


@pytest.mark.parametrize(
    ("body", "cause"),
    [
        ("WORD(0x40036000) = 8;", "write to PDB0 while its clock gate in the SIM is closed"),
        ("WORD(0x40010000) = 8;", "write to 0x40010000, where the chip has no peripheral"),
        (f"{PDB0_ON} WORD(0x40036000) = 8; WORD(0x4004803C) = 1; WORD(0x40036000) = 8;", "while its clock gate"),
    ],
    ids=["gate never opened", "nothing there", "gate closed again"],
)
def test_what_cannot_answer_is_a_bus_error(build_c: Build, body: str, cause: str) -> None:
    board = VirtualK64F(build_c(program(body)))
    with pytest.raises(BoardFault, match=cause):
        board.run_until(0.001)


def test_either_of_two_gates_opens_a_peripheral(build_c: Build) -> None:
    for gate in ("WORD(0x40048030) |= 1u << 24;", "WORD(0x4004803C) |= 1u << 26;"):  # FTM2: SCGC3 or SCGC6
        board = VirtualK64F(build_c(program(f"{gate} WORD(0x4003A008) = 8; after = WORD(0x4003A008);")))
        board.run_until(0.001)
        assert word(board, "after") == 8


def test_a_status_bit_that_never_comes_is_named(build_c: Build) -> None:
    board = VirtualK64F(build_c(program(f"{PDB0_ON} while (!(WORD(0x40036000) & 0x40)) {{}}")))
    board.report_waits(lambda _line: None)
    board.run_until(0.002)
    expected = ", polling PDB0_SC at 0x40036000, which is not modelled"
    assert board.position().startswith("executing timer_init (program.c:")
    assert board.position().endswith(expected)


WAITS = f"{PDB0_ON} while (!(WORD(0x40036000) & 0x40)) {{ after = WORD(0x40036008); }}"


def test_who_waits_for_a_register_that_is_not_modelled_is_told_so_once(build_c: Build) -> None:
    board = VirtualK64F(build_c(program(WAITS)))
    messages: list[str] = []
    board.report_waits(messages.append)
    board.run_until(0.02)
    messages.sort()
    assert len(messages) == 2  # the one that it waits for, and the one that it reads meanwhile
    assert messages[1].startswith("firmware waits for PDB0_SC at 0x40036000, which is not modelled, at 0x")
    assert " in timer_init (program.c:" in messages[1]


def test_without_anyone_to_tell_it_is_a_warning(build_c: Build) -> None:
    board = VirtualK64F(build_c(program(f"{PDB0_ON} while (!(WORD(0x40036000) & 0x40)) {{}}")))
    with pytest.warns(UnmodelledWarning, match=r"waits for PDB0_SC at 0x40036000, which is not modelled, at .*timer_"):
        board.run_until(0.02)


def test_a_called_function_that_waits_for_one_says_so(build_c: Build) -> None:
    board = VirtualK64F(build_c(program(WAITS)))
    board.report_waits(lambda _line: None)
    board.run_until(0.001)
    polling = r"did not return within .*, polling PDB0_.*, which is not modelled at .*timer_init"
    with pytest.raises(BoardFault, match=polling):
        board.call("timer_init", timeout_s=0.01)


def test_reading_a_register_again_after_writing_is_no_wait(build_c: Build) -> None:
    body = f"{PDB0_ON} for (int i = 0; i < 4000; i++) {{ after = WORD(0x40036000); WORD(0x40036004) = i; }}"
    board = VirtualK64F(build_c(program(body)))
    messages: list[str] = []
    board.report_waits(messages.append)
    board.run_until(0.02)
    assert messages == []
    assert word(board, "after") == 0


def test_the_chips_tables_are_whole() -> None:
    chip = mk64f12()
    names = [entry.name for entry in chip.peripherals]
    assert len(set(names)) == len(names) == 73
    registers = [register for entry in chip.peripherals for register in entry.registers]
    assert len({register.name for register in registers}) == len(registers)
    for entry in chip.peripherals:
        for register in entry.registers:
            assert entry.base <= register.address < entry.base + entry.size, register.name
    # A few that everyone knows by heart.
    assert chip.register_name(0x4004803C) == "SIM_SCGC6"
    assert chip.register_name(0x400FF054) == "GPIOB_PDDR"
    assert chip.register_name(0x4006A007) == "UART0_D"
    assert chip.register_name(0x400380A0) == "FTM0+0x0A0"
    assert chip.register_name(0x40010000) is None


USB_INTERRUPT = "WORD(0xE000E104) = 1u << 21;"  # interrupt 53


@pytest.mark.parametrize("wait", ['for (;;) __asm__ volatile ("wfi");', "while (!after) {}"], ids=["asleep", "loop"])
def test_who_waits_for_an_interrupt_of_a_module_that_is_not_modelled_is_told_so_once(build_c: Build, wait: str) -> None:
    source = program(f"{USB_INTERRUPT} {wait}").replace("unsigned before, after", "volatile unsigned before, after")
    board = VirtualK64F(build_c(source))
    messages: list[str] = []
    board.report_waits(messages.append)
    board.run_until(0.01)
    board.run_until(0.02)
    (message,) = messages
    clause = ", with interrupts of USB0 enabled, which the virtual board does not model"
    assert message.startswith(f"firmware waits{clause}, at 0x")
    assert " in timer_init (program.c:" in message
    assert clause in board.position()


@pytest.mark.parametrize(
    ("interrupt", "module"),
    [(40, "CMP0"), (45, "CMT"), (52, "PDB0"), (56, "DAC0"), (75, "CAN0"), (81, "SDHC"), (74, "I2C2")],
)
def test_every_module_that_is_not_modelled_is_named_by_its_interrupt(
    build_c: Build, interrupt: int, module: str
) -> None:
    enable = f"WORD(0x{0xE000E100 + interrupt // 32 * 4:08x}) = 1u << {interrupt % 32};"
    board = VirtualK64F(build_c(program(f'{enable} for (;;) __asm__ volatile ("wfi");')))
    board.report_waits(lambda _line: None)
    board.run_until(0.01)
    assert f"with interrupts of {module} enabled" in board.position()


def test_an_interrupt_that_a_modelled_module_shares_is_named_only_if_the_other_one_is_used(build_c: Build) -> None:
    for use, is_named in (("", False), ("WORD(0x40048034) |= 2; BYTE(0x40061000) = 9;", True)):  # WDOG, EWM
        body = f'{use} WORD(0xE000E100) = 1u << 22; for (;;) __asm__ volatile ("wfi");'
        board = VirtualK64F(build_c(program(body)))
        board.report_waits(lambda _line: None)
        board.run_until(0.01)
        assert ("EWM" in board.position()) is is_named


def test_modelled_interrupts_are_no_remark(build_c: Build) -> None:
    board = VirtualK64F(build_c(program('WORD(0xE000E104) = 1u << 16; for (;;) __asm__ volatile ("wfi");')))  # PIT
    board.run_until(0.01)
    assert "not model" not in board.position()


@pytest.mark.parametrize("other", ["WORD(0x40036004) = 1;", "WORD(0x400FF08C) = 2;"], ids=["write", "another module"])
def test_polling_between_writes_is_counted_without_python(
    other: str, build_c: Build, monkeypatch: pytest.MonkeyPatch
) -> None:
    reports, take = [], UnmodelledLog._take
    monkeypatch.setattr(
        UnmodelledLog, "_take", lambda log, access: (reports.append(access.place), take(log, access))[1]
    )
    on = f"{PDB0_ON} WORD(0x40048038) |= 0x3E00;"
    board = VirtualK64F(build_c(program(f"{on} while (!(WORD(0x40036000) & 0x40)) {{ {other} }}")))
    board.report_waits(lambda _line: None)
    board.run_until(0.05)
    assert len(reports) < 6
    assert sum(access.accesses for access in board.unmodelled if access.register == "PDB0_SC") > 50_000
    reports.clear()
    board.run_until(0.1)
    assert not reports
