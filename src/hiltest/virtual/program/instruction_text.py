"""Text of instructions: mnemonic and operands."""

from __future__ import annotations

from functools import cache
from typing import Any


def instruction_text(address: int, code: bytes) -> str:
    """Return the text of the first instruction of some code; ``.unknown`` if it is invalid."""
    _, _, mnemonic, operands = next(_disassembler().disasm_lite(code, address, 1), (0, 0, ".unknown", ""))
    return f"{mnemonic} {operands}".strip()


@cache
def _disassembler() -> Any:
    import capstone  # takes a tenth of a second, and few runs need it

    return capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)
