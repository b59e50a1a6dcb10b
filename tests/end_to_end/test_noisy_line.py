"""The link checks on a line that loses or flips bytes: noise is called noise, and firmware at fault is still blamed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.boards import RealBoard, VirtualBench, real
from hiltest.boards.bench import START_UP_S
from hiltest.boards.faulty_port import FaultyPort, add_faults
from hiltest.boards.virtual_port import VirtualPort
from hiltest.errors import BenchError
from hiltest.link.ports import READ_SLICE_S
from hiltest.procedures import check_link
from hiltest.procedures.link_checks import LinkCheck
from hiltest.rig.bench_files import shipped
from hiltest.rig.faults import Faults
from hiltest.rig.rig_file import load_rig

from .firmware_edits import Edit, FirmwareCopy

SEEDS = 12
NONE: dict[str, float] = {}
LOST, FLIPPED = {"lose": 2e-4}, {"flip": 3e-4}
# The board is opened by then, on a line that is still quiet.
OPENED_S = 0.2


Open = Callable[..., tuple[RealBoard, Counter[str]]]


@pytest.fixture
def over_noise(monkeypatch: pytest.MonkeyPatch) -> Open:
    """Return a function that opens a board as a real one, on a line that gets noisy afterwards."""
    rig = load_rig(shipped() / "rigs" / "virtual-k64f.toml")

    def opened(noise: dict[str, float], seed: int, firmware: Path | None = None) -> tuple[RealBoard, Counter[str]]:
        bench = VirtualBench(rig, firmware=firmware)
        bench.power_on()
        port = VirtualPort()
        port.timeout = READ_SLICE_S
        port.attach(bench.machine)
        port.open()
        faults = Faults(seed=seed, after_s=OPENED_S, **noise) if noise else None
        line = add_faults(port, faults, baud=115_200)
        monkeypatch.setattr(real, "open_port", lambda _url, *, baud, rig: line)
        board = RealBoard("noisy", rig)
        assert board.now_s() < START_UP_S + OPENED_S
        bench.machine.run_until(START_UP_S + OPENED_S)
        return board, line.happened if isinstance(line, FaultyPort) else Counter()

    return opened


def checked(board: RealBoard) -> LinkCheck | None:
    """Return what the check finds, None where the line lost one request three times in a row: exit code 20."""
    try:
        return check_link(board)
    except BenchError:
        return None


def holds(check: LinkCheck) -> bool:
    return (
        check.wrong == 0
        and check.damaged_counted == check.damaged_sent
        and check.damaged_answered == 0
        and check.repeated_answered
        and check.executed_once
    )


@pytest.mark.parametrize("noise", [LOST, FLIPPED], ids=["lost", "flipped"])
def test_a_noisy_line_is_called_noisy_and_not_the_firmware(over_noise: Open, noise: dict[str, float]) -> None:
    called_noisy = 0
    for seed in range(SEEDS):
        board, spoilt = over_noise(noise, seed)
        check = checked(board)
        if check is not None:
            assert holds(check), f"seed {seed}"
            assert spoilt or not check.noise
            assert check.noise or check.echoed == check.expected
        called_noisy += check is None or bool(check.noise)
    # 25 kB pass: 5 and 7 bytes are spoilt in the mean, one in 150 and in 1000 checks sees none; and what is lost may be
    # one of two delimiters.
    assert called_noisy >= SEEDS - 1


def test_a_line_without_noise_is_not_called_noisy(over_noise: Open) -> None:
    check = check_link(over_noise(NONE, 1)[0])
    assert holds(check)
    assert check.echoed == check.expected
    assert check.noise == ""


SERVER = "app/server.c"
ANSWERED = "    if ((request.type & REPLY_BIT) != 0u) {"
# What is wrong with the firmware, and what the check then finds.
FAULTS: dict[str, tuple[Edit, Callable[[LinkCheck], bool]]] = {
    "does it twice": (
        Edit(SERVER, "if (is_repeated(&request)) {", "if (is_repeated(&request) && last.length == 0u) {"),
        lambda check: not check.repeated_answered,  # the second is refused: another number of points is stored by then
    ),
    "counts first requests as repeated": (
        Edit(SERVER, "        answer(&request);", "        statistics.repeated++;\n        answer(&request);"),
        lambda check: not check.repeated_answered,
    ),
    "counts no damage": (
        Edit(SERVER, "        statistics.damaged++;\n        return;", "        return;"),
        lambda check: check.damaged_counted < check.damaged_sent,
    ),
    "deaf to one size": (
        Edit(SERVER, ANSWERED, ANSWERED.replace("if (", "if (request.payload_length == 257u || ")),
        lambda check: check.echoed == check.expected - 1,
    ),
}


@pytest.mark.ci
@pytest.mark.parametrize("fault", sorted(FAULTS))
def test_firmware_at_fault_is_blamed_on_a_noisy_line_too(
    over_noise: Open, copy_of_the_firmware: FirmwareCopy, tmp_path: Path, fault: str
) -> None:
    edit, blamed = FAULTS[fault]
    elf = copy_of_the_firmware.build(edit, tmp_path / "faulty.elf")
    assert blamed(check_link(over_noise(NONE, 1, elf)[0]))
    checks = [checked(over_noise(noise, seed, elf)[0]) for seed in range(3) for noise in (LOST, FLIPPED)]
    results = [check for check in checks if check is not None]
    assert results
    assert all(blamed(check) for check in results)
