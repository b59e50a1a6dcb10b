"""The page about parts: its table has every virtual board, with its chip, and every rig's board is in it."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from hiltest.rig.bench_files import shipped
from hiltest.virtual.part.machine_file import load_machine
from hiltest.virtual.part.part_file import load_part
from hiltest.virtual.program.elf import CORES

ROOT = Path(__file__).parents[2]
MACHINES = ROOT / "src" / "hiltest" / "virtual" / "part" / "machines"
#: Boards whose chip is described by tables and classes: part and its core.
OTHERS = {"frdm-k64f": "mk64f12", "microbit-v1": "nrf51822"}


def rows() -> dict[str, tuple[str, str, str]]:
    """Return part, core and programs by board."""
    text = (ROOT / "docs" / "add-a-part.md").read_text(encoding="utf-8")
    cells = re.findall(r"^\| (\S+) \| (Cortex\S+) \| `(\S+)` \| (.+) \|$", text, re.MULTILINE)
    return {board: (part, core, programs) for part, core, board, programs in cells}


def test_the_table_has_every_board_with_its_part_and_its_core() -> None:
    parts = OTHERS | {file.stem: load_machine(file.stem).part for file in MACHINES.glob("*.toml")}
    assert {board: core for board, (_, core, _) in rows().items()} == {
        board: CORES[load_part(part).core].title for board, part in parts.items()
    }
    for board, (part, _, programs) in rows().items():
        name = parts[board]
        assert part.lower().startswith(name if name != "mk64f12" else "mk64fn"), board
        assert programs


def test_every_rig_s_board_has_a_program_in_the_table() -> None:
    files = [tomllib.loads(file.read_text(encoding="utf-8")) for file in (shipped() / "rigs").glob("*.toml")]
    boards = {file["board"].get("machine", "frdm-k64f") for file in files if file["board"]["kind"] == "virtual"}
    assert boards <= rows().keys()
    text = {board: programs for board, (_, _, programs) in rows().items()}
    assert "the sample compass" in text["frdm-k64f"]
    assert "the sample compass" in text["stm32f411-disco"]


def test_the_number_of_public_programs_in_the_table_is_that_of_the_page() -> None:
    page = (ROOT / "docs" / "add-a-part.md").read_text(encoding="utf-8")
    ran = re.search(
        r"(\w+) ran as their pages say: (.+?) blink,\s(.+?) print at 115 200 baud, and (.+?) echoes", page, re.S
    )
    assert ran is not None
    names = re.findall(r"`(\w+)`", f"{ran[2]} {ran[3]} {ran[4]}")
    assert (ran[1].lower(), len(names)) == ("eight", 8)
    assert rows()["stm32f407-disco"][2].startswith("eight of ten examples of libopencm3")
