"""The link checks on a line that loses or flips bytes: noise is called noise, and firmware at fault is still blamed."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.bench_files import shipped
from hiltest.boards import Declared, RealBoard, VirtualBench, real
from hiltest.boards.virtual_port import VirtualPort
from hiltest.errors import BenchError
from hiltest.link.ports import READ_SLICE_S
from hiltest.procedures import check_link
from hiltest.procedures.link_checks import LinkCheck
from hiltest.rig.file import load_rig

from .firmware_edits import Edit, FirmwareCopy

SEEDS = 12
LOST, FLIPPED = (2e-4, 0.0), (0.0, 3e-4)


class NoisyPort(VirtualPort):
    """The virtual board's port on a line with noise, both ways.

    Attributes
    ----------
    spoilt : int
        Bytes lost or flipped.
    """

    def __init__(self, lost: float, flipped: float, seed: int) -> None:
        super().__init__()
        self.name = "noisy"
        self.timeout = READ_SLICE_S
        self.spoilt = 0
        self._lost, self._flipped = lost, flipped
        self._dice = random.Random(seed)

    def write(self, data: bytes) -> int:
        super().write(self._through(data))
        return len(data)

    def _take(self) -> None:
        before = len(self._arrived)
        super()._take()
        self._arrived[before:] = self._through(bytes(self._arrived[before:]))

    def _through(self, data: bytes) -> bytes:
        out = bytearray()
        for byte in data:
            drawn = self._dice.random()
            self.spoilt += drawn < self._lost + self._flipped
            if drawn >= self._lost:
                out.append(byte ^ (1 << self._dice.randrange(8)) if drawn < self._lost + self._flipped else byte)
        return bytes(out)


Open = Callable[..., tuple[RealBoard, NoisyPort]]


@pytest.fixture
def over_noise(monkeypatch: pytest.MonkeyPatch) -> Open:
    """Return a function that opens a board as a real one, on a line that gets noisy afterwards."""
    rig = load_rig(shipped() / "rigs" / "virtual-k64f.toml")

    def opened(noise: tuple[float, float], seed: int, firmware: Path | None = None) -> tuple[RealBoard, NoisyPort]:
        bench = VirtualBench(rig, firmware=firmware)
        bench.power_on()
        port = NoisyPort(0.0, 0.0, seed)
        port.attach(bench.machine)
        port.open()
        monkeypatch.setattr(real, "open_port", lambda _url, *, baud, rig: port)
        board = RealBoard("noisy", baud=115_200, declared=Declared.of(rig))
        port._lost, port._flipped = noise
        return board, port

    return opened


def checked(board: RealBoard) -> LinkCheck | None:
    """Return what the check finds, None where the line lost one request three times in a row: exit code 20."""
    try:
        return check_link(board)
    except BenchError:
        return None


def holds(check: LinkCheck) -> bool:
    return (
        check.wrong == 0 and check.damaged_counted == check.damaged_sent and check.damaged_answered == 0
        and check.repeated_answered and check.executed_once
    )  # fmt: skip


@pytest.mark.parametrize("noise", [LOST, FLIPPED], ids=["lost", "flipped"])
def test_a_noisy_line_is_called_noisy_and_not_the_firmware(over_noise: Open, noise: tuple[float, float]) -> None:
    called_noisy = 0
    for seed in range(SEEDS):
        board, port = over_noise(noise, seed)
        check = checked(board)
        if check is not None:
            assert holds(check), f"seed {seed}"
            assert port.spoilt > 0 or not check.noise
            assert check.noise or check.echoed == check.expected
        called_noisy += check is None or bool(check.noise)
    # 25 kB pass: 5 and 7 bytes are spoilt in the mean, one in 150 and in 1000 checks sees none; and what is lost may be
    # one of two delimiters.
    assert called_noisy >= SEEDS - 1


def test_a_line_without_noise_is_not_called_noisy(over_noise: Open) -> None:
    check = check_link(over_noise((0.0, 0.0), 1)[0])
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
    assert blamed(check_link(over_noise((0.0, 0.0), 1, elf)[0]))
    checks = [checked(over_noise(noise, seed, elf)[0]) for seed in range(3) for noise in (LOST, FLIPPED)]
    found = [check for check in checks if check is not None]
    assert found
    assert all(blamed(check) for check in found)
