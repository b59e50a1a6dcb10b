"""An independent emulator executes programs that others published in the same number of instructions."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.virtual.board.k64f import VirtualK64F

from ..firmware.test_instructions_against_qemu import PROGRAMS as OF_FIRMWARE
from ..firmware.test_instructions_against_qemu import executed_by_qemu
from .conftest import PROGRAMS
from .published import FIGURES, SHARED_SECRET

FLAGS = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")
pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("elf", "function", "fewest"),
    [
        ("x25519_m4f", "curve25519_scalarmult", 300_000),
        ("aes_128_ctr", "AES_128_encrypt_ctr", 256 * 300),  # 256 blocks
    ],
)
def test_qemu_executes_as_many_instructions(
    elf: str, function: str, fewest: int, tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    published = next(each for each in FIGURES if (each.elf, each.function) == (elf, function))
    original = VirtualK64F(published.path)
    (segment,) = original.image.segments
    *pointers, length = (*published.arguments(), 0)[:4]
    files = {"THEIRS": segment.data} | dict(zip(("FIRST", "SECOND", "THIRD"), map(bytes, pointers), strict=True))
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    program = tmp_path / "elsewhere.elf"
    subprocess.run(
        [require_tool("arm-none-eabi-gcc"), *FLAGS, "-nostdlib", f"-Wl,-T,{OF_FIRMWARE / 'ram.ld'}",
         *(f'-D{name}="{tmp_path / name}"' for name in files), f"-DLENGTH={length}",
         f"-DOFFSET={original.image.symbols[function].address - segment.address}",
         str(PROGRAMS / "elsewhere.S"), "-o", str(program)],
        check=True, timeout=60,
    )  # fmt: skip
    board = VirtualK64F(program)
    executed = executed_by_qemu(require_tool("qemu-system-arm"), board.image, tmp_path)
    assert board.call("run_kernel").instructions == executed > fewest
    # It computes there what it computes where it was linked for.
    arguments = published.arguments()
    original.call(function, *arguments)
    for name, argument in zip(("first", "second", "third"), arguments, strict=False):
        address = board.image.symbols[name].address
        assert board.processor.memory.read(address, len(argument)) == bytes(argument)
    if elf == "x25519_m4f":
        assert arguments[0] == SHARED_SECRET
