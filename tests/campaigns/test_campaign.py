"""Many seeds summed up: spreads, sentence and exit code, from results written by hand."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from hiltest.campaigns.campaign import SeedResult, campaign_exit_code, campaign_sentence, spreads_of
from hiltest.commands.cli import commands
from hiltest.errors import ConfigError
from hiltest.measurement import Better, Limit, Tolerance, check
from hiltest.run_record.comparison import Change, Comparison, Difference, Side
from hiltest.run_record.journal import JOURNAL_FILE, Journal
from hiltest.session.record_folder import LOCK_FILE, remove_run, sole_command
from hiltest.verdict.evidence_reader import read_evidence
from hiltest.verdict.wording import sentence as comparison_sentence


def result(seed: int, heading_deg: float, exit_code: int = 0) -> SeedResult:
    measurements = (
        check("heading.direct.max", heading_deg, unit="deg", limit=Limit(max=1.8)),
        check("heading.uncalibrated.max", 10.0, unit="deg"),
        check("board.wall_seconds", 5.0 + seed, unit="s", volatile=True),
        check("fit.direct.offset_error", None, unit="uT"),
    )
    return SeedResult(seed, exit_code, "sentence", measurements, excusable=exit_code == 1)


def test_spreads_are_over_the_seeds_that_have_a_number() -> None:
    spreads = spreads_of([result(1, 0.9), result(2, 1.9, 1), result(3, 1.1), SeedResult(4, 20, "lost")])
    assert [spread.name for spread in spreads] == ["heading.direct.max", "heading.uncalibrated.max"]
    heading = spreads[0]
    assert (heading.n, heading.min, heading.median, heading.max) == (3, 0.9, 1.1, 1.9)
    assert heading.failed_seeds == (2,)


@pytest.mark.parametrize(
    ("codes", "may_fail", "code"),
    [
        ([0, 0, 0], 0, 0),
        ([0, 1, 0], 0, 1),
        ([0, 1, 0], 1, 0),
        ([1, 1, 0], 1, 1),
        ([1, 20, 0], 5, 20),
        ([20, 23], 0, 23),
        ([22, 0], 1, 22),
        ([1, 4], 5, 4),
        ([0, 24], 5, 24),
    ],
)
def test_only_so_many_missed_limits_and_nothing_else_are_allowed(codes: list[int], may_fail: int, code: int) -> None:
    results = [SeedResult(seed, code, "", excusable=code == 1) for seed, code in enumerate(codes)]
    assert campaign_exit_code(results, may_fail=may_fail) == code


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "excused"),
    [
        ("measure('mine', 2, '', limit=Limit(max=1))", True),
        ("raise RuntimeError('the suite is broken')", False),
        ("measure('mine', 2, '')\n    assert not 'an assertion of its own'", False),
        ("measure('mine', 2, '', limit=Limit(max=1))\n\ndef test_other():\n    raise RuntimeError('too')", False),
    ],
    ids=["missed limit", "error", "assertion", "missed limit and error"],
)
def test_only_a_missed_limit_may_be_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], body: str, excused: bool
) -> None:
    suites = tmp_path / "hil" / "suites"
    suites.mkdir(parents=True)
    (suites / "test_mine.py").write_text(
        f"from hiltest.measurement import Limit\n\ndef test_mine(measure):\n    {body}\n"
    )
    rig = Path(__file__).parents[2] / "hil" / "rigs" / "virtual-k64f.toml"
    text = rig.read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text[: text.index("[limits]")], encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    code = hiltest_main("run", "--seeds", "1..1", "--may-fail", "1", "--rig", "mine.toml")
    last = capsys.readouterr().out.rstrip().splitlines()[-1]
    begins = "0 of 1 seeds pass (not: 1), all of them may fail"
    assert (code, last) == (
        (0, f"{begins}: PASS.") if excused else (1, f"{begins}, but only by a limit (not: 1): FAIL.")
    )


@pytest.mark.parametrize(
    ("codes", "change", "obstacles", "code", "answer", "word"),
    [
        ([0, 0], Change.UNCHANGED, (), 0, "May be merged (against base.json): 1 unchanged.", "PASS"),
        ([0, 0], Change.WORSE, (), 21, "Not to be merged (against base.json): 1 worse: *(+0.2*).", "REGRESSION"),
        ([0, 0], Change.WORSE, ("no seed in common",), 22, "Cannot say * base.json): no seed *.", "NOT EVALUATED"),
        ([0, 1], Change.WORSE, (), 1, "Not to be merged (against base.json): 1 worse: *.", "FAIL"),
        ([0, 20], Change.UNCHANGED, ("seed 2: lost",), 20, "Cannot say * base.json): seed 2: lost; *.", "FAIL"),
    ],
)
def test_a_comparison_decides_where_the_seeds_have_not(
    codes: list[int], change: Change, obstacles: tuple[str, ...], code: int, answer: str, word: str
) -> None:
    results = [SeedResult(seed, code, "", excusable=code == 1) for seed, code in enumerate(codes, 1)]
    side = Side("base.json", "", "", "", "", "", "", "", (1, 2), "")
    difference = Difference(
        "heading.direct.max",
        "deg",
        change,
        Better.LOWER,
        1.0,
        1.2,
        0.2,
        None,
        2,
        Tolerance(0.01, 0.01),
        None,
        "",
        "",
    )
    comparison = Comparison(side, side, (difference,), obstacles, "")
    comparison = replace(comparison, sentence=comparison_sentence(comparison))
    assert campaign_exit_code(results, may_fail=0, comparison=comparison) == code
    sentence = campaign_sentence(results, [], may_fail=0, comparison=comparison)
    assert fnmatchcase(sentence, f"{answer} * of 2 seeds pass*: {word}."), sentence


def test_the_sentence_says_how_many_passed_and_the_worst() -> None:
    results = [result(1, 0.9), result(2, 1.9, 1), result(3, 1.1)]
    assert campaign_sentence(results, spreads_of(results), may_fail=1) == (
        "2 of 3 seeds pass (not: 2), 1 may fail; heading.direct.max median 1.10, worst 1.90 deg: PASS."
    )
    assert campaign_sentence(results, spreads_of(results), may_fail=0).endswith(": FAIL.")
    assert "seeds pass (not: 2), all of them may fail;" in campaign_sentence(results, spreads_of(results), may_fail=3)


class TestFolder:
    """A campaign's folder is its own, and holds nothing of another."""

    @pytest.mark.slow
    def test_a_second_command_of_several_runs_is_refused_and_told_which_has_the_folder(self, tmp_path: Path) -> None:
        with sole_command(tmp_path):
            with pytest.raises(ConfigError, match=rf"{tmp_path} is in use by process {os.getpid()} on "):
                hiltest_main("run", "--seeds", "1..2", "--out", str(tmp_path))
            assert [path.name for path in tmp_path.iterdir()] == [LOCK_FILE]
        assert list(tmp_path.iterdir()) == []
        (tmp_path / LOCK_FILE).write_text("left by a command that was killed\n")
        with sole_command(tmp_path):
            pass
        assert list(tmp_path.iterdir()) == []

    def test_what_an_earlier_run_left_is_removed_and_what_is_not_ours_or_in_use_stays(self, tmp_path: Path) -> None:
        for name in ("seed-0001", "seed-0002", "seed-0003", "mine"):
            (tmp_path / name).mkdir()
            (tmp_path / name / "report.md").write_text("")
            (tmp_path / name / JOURNAL_FILE).write_text("")
        (tmp_path / "seed-0003" / "notes.txt").write_text("mine")
        busy = Journal(tmp_path / "seed-0002")
        for text in ("seed-0001", "seed-0002", "seed-0003"):
            remove_run(tmp_path / text)
        busy.release()
        assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == [
            "mine",
            f"mine/{JOURNAL_FILE}",
            "mine/report.md",
            "seed-0002",
            "seed-0002/report.md",
            "seed-0003",
            "seed-0003/notes.txt",
        ]

    @pytest.mark.slow
    def test_a_seed_that_is_killed_keeps_what_it_had_measured(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        suites = tmp_path / "hil" / "suites"
        suites.mkdir(parents=True)
        (suites / "test_dies.py").write_text(
            "import os\n\ndef test_one(measure):\n    measure('first', 1, '')\n\n"
            "def test_two():\n    os.kill(os.getpid(), 9)\n"
        )
        monkeypatch.chdir(tmp_path)
        assert hiltest_main("run", "--seeds", "3..3", "--out", "out") == 24
        seeds = json.loads((tmp_path / "out" / "seeds.json").read_text())
        (seed,) = seeds["seeds"]
        assert seed["sentence"].startswith("CUT SHORT: 1 test finished, 1 measurement kept")
        assert [measurement["name"] for measurement in seeds["measurements"]] == ["first"]
        # A single run that is killed in the same folder is what is there now, and not the seeds beside it.
        command = [sys.executable, "-m", "hiltest", "run", "--out", "out"]
        assert subprocess.run(command, capture_output=True, timeout=120, check=False).returncode == -9
        killed = read_evidence(Path("out"))
        assert killed.side.file == "out/journal.jsonl"
        assert "incomplete (cut short)" in killed.faults[0]

    @pytest.mark.slow
    def test_ctrl_c_says_what_is_kept_and_a_report_names_the_records(self, tmp_path: Path) -> None:
        suites = tmp_path / "hil" / "suites"
        suites.mkdir(parents=True)
        (suites / "test_slow.py").write_text(
            "import pathlib, time\n\ndef test_one(measure, hil_settings):\n    measure('first', 1, '')\n"
            "    if hil_settings.seed > 1:\n        pathlib.Path('slow').touch()\n        time.sleep(100)\n"
        )
        command = [sys.executable, "-m", "hiltest"]
        running = subprocess.Popen(
            [*command, "run", "--seeds", "1..4", "--out", "out"],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            waited_until = time.monotonic() + 60
            while not ((tmp_path / "slow").exists() and (tmp_path / "out" / "seed-0001" / "report.md").exists()):
                assert time.monotonic() < waited_until
                time.sleep(0.05)
            time.sleep(1.0)  # until the first seed's process has ended too: it is the terminal that asks all of them
            os.killpg(running.pid, signal.SIGINT)
            out, _ = running.communicate(timeout=60)
        finally:
            if running.poll() is None:
                os.killpg(running.pid, signal.SIGKILL)
        assert running.returncode == 2
        assert out.splitlines()[-1].startswith(
            "1 of 4 seeds finished; records in out/seed-0001; cut short: out/seed-000"
        ), out
        done = subprocess.run([*command, "report", "out"], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 4
        answer = "out: a campaign, not one run: cut short or going on, without seeds.md; name one of its folders"
        assert answer in done.stderr
        (tmp_path / "out" / "seeds.md").write_text("")
        done = subprocess.run([*command, "report", "out"], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert "out: a campaign, not one run: all its seeds are in out/seeds.md; name one of its folders" in done.stderr


def hiltest_main(*arguments: str) -> int:
    code = commands.main(args=list(arguments), prog_name="hiltest", standalone_mode=False)
    assert isinstance(code, int)
    return code
