"""The page about timing: its commands run and print what it shows, and its profile and rig are read."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from io import StringIO
from pathlib import Path

from rich.console import Console
from tests.finished_run import run_module

from hiltest.boards import open_board
from hiltest.boards.bench import default_firmware
from hiltest.link.messages import Calibrate
from hiltest.procedures.cycles import upload_points
from hiltest.procedures.golden_points import golden_points
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig
from hiltest.text import format_number
from hiltest.virtual.model.profile_file import DEFAULT_PROFILE, ROWS, RULES, load_profile
from hiltest.virtual.profiling.timing_table import print_judgements
from hiltest.virtual.program.elf import load_image
from hiltest.virtual.silicon.rule_candidates import judge, predicted_clocks, questions

PAGE = (Path(__file__).parents[2] / "docs" / "timing.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^```sh\nhiltest (.*?)\n```", PAGE, re.M | re.S)
SHOWN, TOTAL, JUDGED = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)
ROW, BOARD = re.findall(r"^```toml\n(.*?)^```", PAGE, re.M | re.S)


def run(*arguments: str, folder: Path) -> str:
    done = run_module("hiltest", *arguments, folder=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_command_prints_what_the_page_shows(tmp_path: Path) -> None:
    printed = [" ".join(line.split()) for line in run(*shlex.split(COMMANDS[0]), folder=tmp_path).splitlines()]
    for line in SHOWN.splitlines():
        # "..." stands for what is left out.
        pattern = ".*".join(re.escape(" ".join(part.split())) for part in line.split("..."))
        assert any(re.fullmatch(pattern.replace(".*", r"\s?.*"), item) for item in printed), line


def test_the_json_has_every_row_of_the_profile(tmp_path: Path) -> None:
    content = json.loads(run("timing", "show", "--json", folder=tmp_path))
    profile = load_profile(DEFAULT_PROFILE)
    assert (content["schema"], content["name"], content["digest"]) == ("hiltest.timing/1", profile.name, profile.digest)
    assert [row["row"] for row in content["rows"]] == [*ROWS, *(rule for rule in RULES if rule in profile.rows)]
    assert {row["row"]: (row["cycles"], tuple(row["band"]), row["source"]) for row in content["rows"]} == {
        name: (row.value, row.band, row.source) for name, row in profile.rows.items()
    }


def test_the_changed_row_of_the_page_makes_a_profile_that_is_shown_and_counted_by(tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text(ROW, encoding="utf-8")
    shown = run("timing", "show", "--profile", "my.toml", folder=tmp_path)
    assert tomllib.loads(ROW)["cost"]["fp_store"]["source"] in " ".join(shown.split())
    counted = run("profile", "--profile", "my.toml", "shipped", "crc32", "text:123456789", "9", folder=tmp_path)
    assert re.search(r"cycle model my-board/1\+[0-9a-f]{8}@flash", counted)
    assert tomllib.loads(BOARD) == {"board": {"kind": "virtual", "timing": "my.toml"}}


def test_the_count_of_the_page_is_what_the_shipped_firmware_costs_and_its_range() -> None:
    with open_board(load_rig(shipped() / "rigs" / "virtual-k64f.toml")) as board:
        upload_points(board, golden_points(100))
        cost = board.session.request(Calibrate(100, "direct")).cost
        assert cost is not None
        band = board.cycle_range(cost)
    assert band is not None
    head, shown = ([word.strip() for word in re.split(r"  +", line)] for line in TOTAL.splitlines())
    assert head == ["measurement", "cycles", "lowest", "highest", "largest contributor"]
    assert band.moved_most_by is not None
    assert shown == [
        "cycles.direct.total",
        *map(format_number, (cost.cycles, band.low, band.high)),
        band.moved_most_by.row,
    ]


def test_code_in_flash_is_counted_as_the_page_says_and_carries_what_it_says(tmp_path: Path) -> None:
    shown = run(*shlex.split(COMMANDS[1]), folder=tmp_path)
    words = r"^(\d+) cycles, .*@flash: (\d+) to (\d+), by the uncertainty of the memories"
    match = re.search(words, shown, re.M | re.S)
    assert match is not None
    cycles, low, high = map(int, match.groups())
    assert (low, high) == (round(0.85 * cycles), round(1.15 * cycles))


def test_the_command_for_owners_of_a_board_is_one_that_there_is(tmp_path: Path) -> None:
    (command,) = (command for command in COMMANDS if command.startswith("timing measure"))
    done = run_module("hiltest", *shlex.split(command.replace("/dev/ttyACM0", "/dev/no-such-port")), folder=tmp_path)
    assert done.returncode == 4
    assert "no serial port '/dev/no-such-port'" in done.stderr


def test_the_candidates_of_the_page_predict_what_it_says() -> None:
    image, profile = load_image(default_firmware()), load_profile("cortex-m4-trm/3")
    asked = questions({name: row.value for name, row in profile.rows.items()})
    clocks = {item.sequence: predicted_clocks(image, profile, item.sequence) for item in asked}
    console = Console(file=StringIO(), width=80)
    print_judgements(console, judge(clocks, profile, image))
    assert JUDGED in console.file.getvalue()  # type: ignore[attr-defined]
