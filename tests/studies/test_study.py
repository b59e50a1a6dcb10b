"""A study gives the same numbers however its blocks are shared, interrupted and joined again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from scipy.stats import binom
from tests.command_files import json_schema, run

from hiltest.errors import ConfigError
from hiltest.measurement import KINDS, identify
from hiltest.measurement.estimates import Estimate
from hiltest.run_record.reader import read_record
from hiltest.studies import NAMES
from hiltest.studies.ellipsoids import NOISE_UT, interval
from hiltest.studies.instances import Model, non_ellipsoids
from hiltest.studies.study import Conditions, Plan, blocks_of, measure_block, study_of
from hiltest.studies.study_run import BLOCKS_FILE, run_study

PLAN = Plan("ellipsoids", 3, 60, 20)


class Progress:
    """Keeps what is shown, and asks to end after some blocks."""

    def __init__(self, blocks: int = 1000) -> None:
        self.shown: list[tuple[str, int, int]] = []
        self._blocks = blocks

    def __call__(self, case: str, done: int, of: int) -> None:
        self.shown.append((case, done, of))

    def asked_to_end(self) -> bool:
        return len(self.shown) > self._blocks


def content(folder: Path) -> dict[str, Any]:
    """What must be the same in two records of one plan."""
    record: dict[str, Any] = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    return {key: record[key] for key in ("verdict", "seed", "measurements", "tables")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a study that was not interrupted."""
    folder = tmp_path_factory.mktemp("whole")
    run_study(PLAN, folder, jobs=1, progress=Progress())
    return folder


def test_the_counts_are_those_of_the_fit_in_numpy(whole: Path) -> None:
    table = read_record(whole).run.table("study.ellipsoids")
    assert table is not None
    counts = [non_ellipsoids(Model(3, 20, noise_ut, stream=k), 0, 60) for k, noise_ut in enumerate(NOISE_UT)]
    assert list(table.column("non_ellipsoids")) == counts
    assert min(counts) < 3 < max(counts)
    total = read_record(whole).run.measurement("study.ellipsoids.non_ellipsoids")
    assert total is not None
    assert total.value == sum(counts)


@pytest.mark.parametrize("jobs", [2, 3])
def test_the_numbers_do_not_depend_on_the_jobs(whole: Path, tmp_path: Path, jobs: int) -> None:
    run_study(PLAN, tmp_path, jobs=jobs, progress=Progress())
    assert content(tmp_path) == content(whole)


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.parametrize("after", [1, 7, 15])
def test_what_was_interrupted_goes_on_and_counts_nothing_twice(
    whole: Path, tmp_path: Path, jobs: int, after: int
) -> None:
    first, second = Progress(after), Progress()
    with pytest.raises(KeyboardInterrupt):
        run_study(PLAN, tmp_path, jobs=jobs, progress=first, asked_to_end=first.asked_to_end)
    contents = [json.loads(line) for line in (tmp_path / BLOCKS_FILE).read_text(encoding="utf-8").splitlines()]
    done = {item["number"] for item in contents if item["kind"] == "block"}
    assert after <= len(done) < 20
    assert not (tmp_path / "run.json").exists()
    run_study(PLAN, tmp_path, jobs=jobs, progress=second)
    assert second.shown[0] == ("ellipsoids: instances", 0, 60 * (20 - len(done)))
    assert content(tmp_path) == content(whole)
    assert not (tmp_path / BLOCKS_FILE).exists()


@pytest.mark.slow
@pytest.mark.parametrize("ended_by", [signal.SIGINT, signal.SIGKILL])
def test_the_command_goes_on_after_ctrl_c_and_after_being_killed(tmp_path: Path, ended_by: signal.Signals) -> None:
    words = ["study", "ellipsoids", "--instances", "20000", "--jobs", "2", "--out", str(tmp_path)]
    command = [sys.executable, "-m", "hiltest", *words]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    stored, until_s = tmp_path / BLOCKS_FILE, time.monotonic() + 60.0
    while not (stored.exists() and b'"block"' in stored.read_bytes()) and time.monotonic() < until_s:
        time.sleep(0.005)
    os.killpg(process.pid, ended_by)  # as a terminal does: to the workers too
    _, answer = process.communicate(timeout=60.0)
    assert process.returncode == (2 if ended_by is signal.SIGINT else -signal.SIGKILL)
    if ended_by is signal.SIGINT:
        assert "repeat the command to continue" in answer
    assert not (tmp_path / "run.json").exists()
    before = stored.read_bytes().count(b'"block"')
    assert 0 < before < 20
    assert run(*words) == 0
    again = tmp_path / "again"
    again.mkdir()
    run_study(Plan("ellipsoids", 1, 20000, 100), again, jobs=2, progress=Progress())
    assert content(tmp_path) == content(again)


@pytest.mark.parametrize(
    "line",
    [
        b"{",
        b"[]",
        b'{"kind": "block"}',
        b'{"kind": "block", "number": 20, "numbers": [1]}',
        b'{"kind": "block", "number": true, "numbers": [1]}',
        b'{"kind": "block", "number": 1, "numbers": ["1"]}',
        b'{"kind": "block", "number": 1, "numbers": 1}',
        b'{"kind": "start"}',
        b"\xff",
    ],
)
def test_kept_blocks_that_are_damaged_are_refused(tmp_path: Path, line: bytes) -> None:
    (tmp_path / BLOCKS_FILE).write_bytes(line + b"\n")
    with pytest.raises(ConfigError, match=r"line 1 is damaged.*remove it"):
        run_study(PLAN, tmp_path, jobs=1, progress=Progress())
    assert (tmp_path / BLOCKS_FILE).read_bytes() == line + b"\n"


@pytest.mark.parametrize(
    "other",
    [
        Plan("ellipsoids", 4, 60, 20),
        Plan("ellipsoids", 3, 61, 20),
        Plan("ellipsoids", 3, 60, 21),
        Plan("ellipsoids", 3, 60, 20, Conditions()),
    ],
)
def test_blocks_of_another_plan_are_neither_mixed_in_nor_thrown_away(tmp_path: Path, other: Plan) -> None:
    ending = Progress(1)
    with pytest.raises(KeyboardInterrupt):
        run_study(PLAN, tmp_path, jobs=1, progress=ending, asked_to_end=ending.asked_to_end)
    before = (tmp_path / BLOCKS_FILE).read_bytes()
    with pytest.raises(ConfigError, match=r"another study: hiltest .*seed 3, instances 60, points 20"):
        run_study(other, tmp_path, jobs=1, progress=Progress())
    assert (tmp_path / BLOCKS_FILE).read_bytes() == before


@given(instances=st.integers(1, 300_000))
def test_blocks_have_every_instance_once(instances: int) -> None:
    blocks = blocks_of(Plan("ellipsoids", 1, instances, 100))
    for condition in range(len(NOISE_UT)):
        mine = [block for block in blocks if block.condition == condition]
        ends = [block.first + block.count for block in mine]
        assert [block.first for block in mine] == [0, *ends[:-1]]
        assert ends[-1] == instances


@pytest.mark.parametrize(("count", "of"), [(0, 100), (1, 100), (37, 100), (100, 100), (6706, 20_000_000)])
def test_the_interval_leaves_out_2_5_percent_on_either_side(count: int, of: int) -> None:
    low, high = interval(count, of)
    assert low == 0.0 if count == 0 else binom.sf(count - 1, of, low) == pytest.approx(0.025)
    assert high == 1.0 if count == of else binom.cdf(count, of, high) == pytest.approx(0.025)


# `budget` runs on the virtual board, for a second an instance.
SLOW = {"budget"}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in NAMES])
class TestEveryStudy:
    """What holds of each study."""

    def test_a_block_follows_from_plan_and_number_and_json_holds_it(self, name: str) -> None:
        plan = Plan(name, 5, 4, study_of(name).points)
        numbers = list(measure_block(plan, 0))
        assert list(measure_block(plan, 0)) == numbers
        assert json.loads(json.dumps(numbers, allow_nan=False)) == numbers

    def test_the_command_leaves_a_record_and_a_page_with_every_printed_figure(
        self, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        assert run("study", name, "--instances", "2", "--jobs", "1", "--out", str(tmp_path)) == 0
        output = capsys.readouterr().out
        record = read_record(tmp_path)
        assert not list(Draft202012Validator(json_schema("hiltest.run/1")).iter_errors(record.file.content))
        kinds = [identify(measurement.name).kind for measurement in record.run.measurements]
        assert {kind.name for kind in kinds if kind} == {kind for kind in KINDS if kind.startswith(f"study.{name}.")}
        assert None not in kinds
        page = (tmp_path / "study.html").read_text(encoding="utf-8").replace("\N{NO-BREAK SPACE}", " ")
        assert page.count("<svg") > 0
        assert study_of(name).question in page
        assert bool(study_of(name).unprinted) == (name in ("choose", "dpi", "estimators"))
        assert study_of(name).unprinted.replace("'", "&#39;") in page
        printed = record.run.table(f"study.{name}.printed")
        assert printed is not None
        assert bool(printed.rows) == ("What the papers printed" in page) == (name != "choose")
        for row in printed.rows:
            assert f"{row[0]}: printed {row[2]}, measured" in output
            for text in (row[0], row[1]):
                assert str(text) in page
        table = record.run.table(f"study.{name}")
        assert table is not None
        for place, column in enumerate(table.columns):
            if column.name.endswith(", at least"):
                for value, low, high in (row[place - 1 : place + 2] for row in table.rows):
                    assert value is None or str(Estimate(value, low, high)) in page  # type: ignore[arg-type]
        assert run("report", str(tmp_path)) == 0


def test_a_folder_that_cannot_be_made_is_4(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert run("study", "ellipsoids", "--instances", "1", "--out", str(tmp_path / "file" / "study")) == 4
