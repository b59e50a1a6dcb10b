"""Whatever moment a run is killed at, its folder holds the run before, nothing, or every test that had finished."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.run_record.files import RECORD_FILES
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Run

pytestmark = pytest.mark.slow

PROGRAM = Path(__file__).parent / "programs" / "dying_recorder.py"
OLD, NEW = 1.0, 2.0  # what the tests of the run before measured, and those of the run that dies


@pytest.fixture(scope="module", params=["line FINISHED", "line CUT_SHORT", "byte NOTHING"])
def died(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return the folders of runs that were killed, each one step further on than the one before; the last was not."""
    top = tmp_path_factory.mktemp("died")
    subprocess.run([sys.executable, PROGRAM, top, *request.param.split()], check=True, timeout=300)
    return sorted(path for path in top.iterdir() if path.is_dir() and path.name != "earlier")


def witnessed(folder: Path, case: str) -> list[str]:
    path = folder.with_suffix(f".{case}")
    return path.read_text().split() if path.exists() else []


def values(run: Run) -> dict[str, object]:
    return {measurement.name: measurement.value for measurement in run.measurements}


def stored(folder: Path) -> Run | None:
    """Return what can be read in a folder, None if nothing was written yet."""
    try:
        return read_record(folder).run
    except ConfigError as error:
        if "no record of a run" not in str(error):
            raise
        return None


def test_every_finished_test_is_read_and_nothing_else(died: list[Path]) -> None:
    outcomes = []
    for folder in died:
        run, begun, finished = stored(folder), witnessed(folder, "begun"), witnessed(folder, "finished")
        if run is None or set(values(run).values()) == {OLD}:
            assert not begun, folder
            outcomes.append("before")
            continue
        tests = [test.id for test in run.tests]
        # A test is finished for the record before the process can say so itself.
        assert tests in (finished, begun), folder
        assert values(run) == {f"{test}.value": NEW for test in tests}, folder
        assert [table.name for table in run.tables] == [f"{test}.rows" for test in tests], folder
        assert run.verdict.complete == (run.verdict.outcome == "pass")
        outcomes.append(run.verdict.outcome)
    # Every stage was met, in this order, and none again after the next.
    assert [name for name, after in zip(outcomes, [*outcomes[1:], ""], strict=True) if name != after] == [
        "before",
        "cut short",
        "pass",
    ]
    assert outcomes.count("cut short") > 10


def test_from_its_first_test_on_no_report_of_the_run_before_lies_beside_the_record(died: list[Path]) -> None:
    for folder in died:
        run = stored(folder)
        if witnessed(folder, "begun") and run is not None:
            pages = [(folder / name).read_text() for name in ("report.html", "report.md") if (folder / name).exists()]
            word = run.verdict.outcome.upper()
            words = (word, run.verdict.sentence.removeprefix(word).lstrip(".: "))
            assert all(part in page for page in pages for part in words), folder
            assert not (folder / "run.json").exists() or run.verdict.outcome == "pass", folder


def test_the_next_run_finds_the_folder_free_and_leaves_nothing_half_written(died: list[Path]) -> None:
    program = (
        "import sys; from pathlib import Path; sys.path.insert(0, sys.argv[1]); import dying_recorder;"
        "[dying_recorder.keep_record(Path(each), 3.0) for each in sys.argv[2:]]"
    )
    chosen = died[::10]
    subprocess.run([sys.executable, "-c", program, PROGRAM.parent, *chosen], check=True, timeout=300)
    for folder in chosen:
        assert {path.name for path in folder.iterdir()} == set(RECORD_FILES) - {"junit.xml"}
        assert set(values(read_record(folder).run).values()) == {3.0}
