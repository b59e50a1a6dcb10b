"""Whatever types a program has: what its initialisers write is what the paths read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from hiltest.interfaces.variables import Variables
from hiltest.virtual.program.elf import load_image

from .compiled import InitialMemory, compile_c
from .random_structs import Program

VARIABLES = 60


@pytest.mark.parametrize(
    ("seed", "flags"),
    [
        (0, "-O0 -gdwarf-5"),
        (1, "-O2 -gdwarf-4"),
        (2, "-O2 -gdwarf-5 -fno-short-enums"),
        (3, "-O1 -gdwarf-2 -gstrict-dwarf"),
        (4, "-O0 -gdwarf-3"),
    ],
)
def test_what_random_initialisers_write_is_read(
    seed: int, flags: str, tmp_path: Path, require_tool: Callable[[str], str]
) -> None:
    program = Program(seed, VARIABLES)
    image = load_image(compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, program.source, *flags.split(), "-w"))
    variables, memory = Variables(image), InitialMemory(image)
    read = {}
    for path in program.values:
        place = variables.place(path)
        read[path] = place.numbers(place.read(memory))
    assert read == program.values
    assert len(read) > 5 * VARIABLES
