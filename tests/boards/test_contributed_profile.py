"""What owners of boards send in is checked: complete, signed off, and its rows those of its clocks."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.command_files import run
from tests.test_json_documents import checked

from hiltest.boards.bench import default_firmware
from hiltest.link.sequences import SEQUENCES
from hiltest.virtual.model.profile_file import shipped_profiles
from hiltest.virtual.part.unique_id import VIRTUAL_UNIQUE_ID
from hiltest.virtual.program.elf import load_image
from hiltest.virtual.silicon.contributed_profile import check

PAGE = (Path(__file__).parents[2] / "docs" / "silicon.md").read_text(encoding="utf-8")
CHIP = "0123456789abcdef0123456789abcdef"
NAME = f"silicon-{CHIP}.toml"
SIGNED = "Ada Example <ada@example.org>"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What a chip with the core of the virtual board would leave: no real one is at hand."""
    file = tmp_path_factory.mktemp("measured") / "measured.toml"
    assert run("timing", "measure", "--out", str(file)) == 0
    return file.read_text(encoding="utf-8").replace(VIRTUAL_UNIQUE_ID.hex(), CHIP).replace("virtual-", "silicon-")


@pytest.fixture
def filled_in(measured: str) -> str:
    """The same as its owner fills it in by the page."""
    by_hand = re.findall(r"^   ((?:name|revision|signed_off_by) = .*)$", PAGE, re.M)
    text = measured
    for line in by_hand:
        key, value = line.split(" = ")
        text, times = re.subn(rf'^{key} = "".*$', f"{key} = {value}", text, count=1, flags=re.M)
        assert times == 1
    return text.replace("Name <address>", SIGNED)


@pytest.fixture
def objections(tmp_path: Path) -> Callable[[str], tuple[str, ...]]:
    """Return what is said against a file of this text."""

    def of(text: str) -> tuple[str, ...]:
        (tmp_path / NAME).write_text(text, encoding="utf-8")
        return check(tmp_path / NAME, load_image(default_firmware()), SEQUENCES).objections

    return of


def test_it_can_be_sent_in_when_its_owner_has_filled_it_in(
    measured: str, filled_in: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(NAME).write_text(measured, encoding="utf-8")
    assert run("timing", "check", NAME) == 1
    assert re.findall(r"board\.(\w+) is empty", capsys.readouterr().out) == ["name", "revision", "signed_off_by"]
    Path(NAME).write_text(filled_in, encoding="utf-8")
    assert run("timing", "check", NAME) == 0
    (shown,) = re.findall(r"^   ```text\n   (.*?)\n   ```", PAGE, re.M | re.S)
    assert capsys.readouterr().out.strip() == shown
    assert run("timing", "check", NAME, "--json") == 0
    assert checked(capsys.readouterr().out, "hiltest.timing-check/1")["objections"] == []


@pytest.mark.parametrize(
    ("pattern", "instead", "message"),
    [
        (r"^divide = (\d+)$", "divide = 104", "cost.divide does not follow from the clocks, which give 13"),
        (r"(?<=\[cost.divide\]\nvalue = )12\nband = \[12, 12\]", "11\nband = [11, 12]", "cost.divide does not follow"),
        (r"^\[cost.load\]\n.*\n.*\n.*\n", "", "cost.load does not follow from the clocks, which give 2"),
        (r"^divide = \d+$", "divide = -1", "clocks must be whole numbers"),
        (r"^divide = \d+\n", "", "lacks clocks of the"),
        (r"^\[measured.flash_alone\].*\n(?:\w+ = \d+\n)+", "", "[measured.flash_alone] lacks clocks"),
        (r"^base = .*$", 'base = "cortex-m4-k64f/3"', "but these clocks require cortex-m4-trm/3"),
        (r"^build_id = .*$", 'build_id = "0000000000000000"', "flash the shipped one and measure again"),
        (CHIP, VIRTUAL_UNIQUE_ID.hex(), "is not the profile of the chip"),
        (r"^signed_off_by = .*$", 'signed_off_by = "somebody"', "must be Name <address>"),
        (r"^revision = .*$", 'revision = ""', "board.revision is empty"),
        (r"^revision = .*$", 'revision = "\\u001b[2J"', "one line of at most"),
        (r"^core_clock_hz = .*$", 'core_clock_hz = "fast"', "board.core_clock_hz: must be a number"),
        (r"^date = .*$", 'date = "yesterday"', "board.date: must be a date"),
        (r"^\[board\]\n(?:\w+ = .*\n)+", "", "there is no table [board]"),
    ],
)
def test_what_is_missing_or_does_not_fit_is_named(
    filled_in: str, objections: Callable[[str], tuple[str, ...]], pattern: str, instead: str, message: str
) -> None:
    assert objections(filled_in) == ()
    changed, times = re.subn(pattern, lambda _match: instead, filled_in, count=1, flags=re.M)
    assert times == 1
    assert any(message in objection for objection in objections(changed)), objections(changed)


def test_a_new_measurement_keeps_the_board_and_wants_a_new_signature(filled_in: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    as_virtual = filled_in.replace(CHIP, VIRTUAL_UNIQUE_ID.hex()).replace("silicon-", "virtual-")
    file.write_text(as_virtual, encoding="utf-8")
    assert run("timing", "measure", "--out", str(file)) == 0
    text = file.read_text(encoding="utf-8")
    assert 'name = "FRDM-K64F"\nrevision = "E4"\n' in text
    assert re.search(r'^signed_off_by = ""', text, re.M)


def test_what_was_sent_in_holds() -> None:
    sent = [file for file in shipped_profiles().values() if file.parent.name == "silicon"]
    image = load_image(default_firmware())
    assert {file.name: check(file, image, SEQUENCES).objections for file in sent} == {
        message.name: () for message in sent
    }
