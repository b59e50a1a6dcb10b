"""The job's summary of runs that belong together: one for all of them, red when one of them is."""

from __future__ import annotations

import os
from fnmatch import fnmatchcase
from pathlib import Path

import pytest
from tests.finished_run import run_module

from hiltest.verdict.evidence_reader import read_evidence

pytestmark = pytest.mark.slow

SUITE = """
from hiltest.measurement import Limit

def test_seed(measure, board):
    measure("mine.seed", board.seed, "", limit=Limit(max={most}))
    measure("mine.cycles", 7, "cycle", cycle_model="mine/1@flash")
"""
RIG = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
FIRMWARE = Path(__file__).parents[2] / "src" / "hiltest" / "firmware"


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A bench of one's own with one test, and a rig without limits that it would not meet."""
    text = RIG.read_text(encoding="utf-8")
    (tmp_path / "hil" / "rigs").mkdir(parents=True)
    (tmp_path / "hil" / "suites").mkdir()
    (tmp_path / "hil" / "rigs" / RIG.name).write_text(text[: text.index("[limits]")], encoding="utf-8")
    (tmp_path / "hil" / "suites" / "test_mine.py").write_text(SUITE.format(most=5))
    return tmp_path


@pytest.mark.parametrize(
    ("options", "ending"),
    [
        ((), "0 of 1 seeds pass (not: 1): FAIL."),
        (
            ("--baseline", "base"),
            "* (against base/run.json): *: no record on seed 1: * 0 of 1 seeds pass (not: 1): FAIL.",
        ),
    ],
    ids=["no gate", "a gate"],
)
def test_seeds_without_a_record_are_no_pass(bench: Path, options: tuple[str, ...], ending: str) -> None:
    assert run(bench, "--out", "base")[0] == 0
    code, answer, _ = run(bench, "--seeds", "1..1", *options, "--", "--collect-only")
    assert code == 22, answer
    assert fnmatchcase(answer.rstrip().splitlines()[-1], ending), answer
    assert "no record of a run" in answer


def test_of_a_run_and_a_campaign_in_one_folder_the_newer_counts(bench: Path) -> None:
    folder = bench / "hil-out"
    for arguments, target, gone in [
        ((), "run.json", "seeds.json"),
        (("--seeds", "2..2"), "seeds.json", "run.json"),
        ((), "run.json", "seeds.json"),
    ]:
        code, answer, _ = run(bench, *arguments)
        assert code == 0, answer
        assert (folder / target).exists()
        assert not (folder / gone).exists()
        assert read_evidence(folder).side.seeds == ((2,) if arguments else (1,))


def run(folder: Path, *arguments: str) -> tuple[int, str, str]:
    """Return exit code, what was printed, and the job's summary."""
    summary = folder / "summary.md"
    kept = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    done = run_module(
        "hiltest",
        "run",
        *arguments,
        folder=folder,
        environment={**kept, "GITHUB_STEP_SUMMARY": str(summary), "GITHUB_ACTIONS": "true"},
    )
    return done.returncode, done.stdout + done.stderr, summary.read_text(encoding="utf-8")


def test_a_campaign_has_one_summary_for_all_its_seeds(bench: Path) -> None:
    code, answer, page = run(bench, "--seeds", "1..2")
    assert code == 0, answer
    assert [line for line in page.splitlines() if line.startswith("# ")] == ["# PASS"]
    assert "2 of 2 seeds pass: PASS." in page
    assert "| mine.seed | 2 | 1 | 1.5 | 2 |  |  |" in page
    assert "\ncycles counted by mine/1@flash\n" in page
    assert (bench / "hil-out" / "seeds.md").read_text(encoding="utf-8") == page
    assert "::error" not in answer


def test_a_red_seed_is_in_the_summary_and_the_campaign_is_annotated_once(bench: Path) -> None:
    code, answer, page = run(bench, "--seeds", "5..6")
    assert code == 1, answer
    assert page.startswith("# FAIL\n")
    assert "| 6 | 1 | FAIL" in page[: page.index("<details>")]
    (annotation,) = [line for line in answer.splitlines() if line.startswith("::")]
    assert annotation.startswith("::error title=hiltest%3A fail::1 of 2 seeds pass (not: 6): FAIL.")


def test_two_firmwares_have_one_summary_that_compares_them(bench: Path) -> None:
    elf = FIRMWARE / "hiltest-frdm-k64f.elf"
    code, answer, page = run(bench, "--against", str(elf))
    assert code == 0, answer
    assert answer.count("The packaged firmware was compared: name yours with --firmware ELF") == 1
    assert "The packaged firmware was compared" in page
    assert [line for line in page.splitlines() if line.startswith("# ")] == [
        "# May be merged (against hil-out/against/run.json): PASS"
    ]
    assert "## Against the baseline" in page


@pytest.mark.parametrize("named", [False, True])
def test_a_campaign_of_the_packaged_firmware_says_so_where_nobody_named_it(bench: Path, named: bool) -> None:
    elf = FIRMWARE / "hiltest-frdm-k64f.elf"
    newer = ("--firmware", str(elf)) if named else ()
    code, answer, page = run(bench, "--seeds", "1..1", "--against", str(elf), *newer)
    assert code == 0, answer
    assert (answer + page).count("The packaged firmware was compared") == (0 if named else 2)
