"""``hiltest explain``: cause, evidence and source lines of a run."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from tests import in_process
from tests.command_files import checked
from tests.finished_run import Finished

from hiltest.boards import default_firmware
from hiltest.studies.board_calibrators import BoardCalibrators


@pytest.fixture
def folder(tmp_path: Path, default_run: Finished) -> Path:
    """A folder with the record of a run."""
    (tmp_path / "run.json").write_bytes((default_run.folder / "run.json").read_bytes())
    return tmp_path


def changed(folder: Path, default_run: Finished, file: str, **values: float) -> None:
    """Write the record with other values of measurements, whose names have ``_`` for a dot."""
    record = default_run.record
    for row in record["measurements"]:
        if (value := values.get(row["name"].replace(".", "_"))) is not None:
            row["value"] = value
            if row["limit"] and row["limit"]["max"] is not None and value > row["limit"]["max"]:
                row["outcome"] = "fail"
    (folder / file).write_text(json.dumps(record), encoding="utf-8")


def explained(folder: Path, *words: str) -> dict[str, Any]:
    result = in_process.hiltest("explain", *words, "--json", folder=folder)
    assert result.returncode == 0, result.stderr
    return checked(result.stdout, "hiltest.explanation/1")


def test_changed_measurements_are_evidence_and_unchanged_ones_are_not(folder: Path, default_run: Finished) -> None:
    changed(folder, default_run, "dearer.json", cycles_direct_total=11_300.0)
    explanation = explained(folder, "dearer.json", "--baseline", "run.json")
    assert explanation["sentence"].startswith("Not to be merged (against run.json): 1 worse: cycles.direct.total")
    ((name, base, new),) = [(row["name"], row["base"], row["new"]) for row in explanation["changes"]]
    assert (name, base, new) == ("cycles.direct.total", 11_270, 11_300)
    # Both records name the packaged firmware, which was profiled: it has no lines that differ from its own.
    assert explanation["functions"] == []
    assert "no line of these calibrators costs more or less on their 100 points; " in explanation["remark"]


def test_the_cause_of_a_failed_run_comes_with_its_next_step(folder: Path, default_run: Finished) -> None:
    changed(folder, default_run, "failed.json", heading_direct_max=9.0)
    explanation = explained(folder, "failed.json")
    assert [failure["name"] for failure in explanation["failures"]] == ["heading.direct.max"]
    assert explanation["causes"]
    assert explanation["next_steps"]
    assert explanation["changes"] == []
    assert explanation["remark"] == "the run was compared with nothing; name a --baseline"


def test_the_next_step_after_too_many_cycles_is_a_command_that_runs(folder: Path, default_run: Finished) -> None:
    changed(folder, default_run, "dear.json", cycles_direct_total=99_000.0)
    (step,) = explained(folder, "dear.json")["next_steps"]
    command = step.removesuffix(".").partition("hiltest ")[2].split()
    assert command == ["profile", "shipped", "direct"]
    assert "magnetometer_direct()" in in_process.hiltest(*command, folder=folder).stdout


def test_an_elf_that_was_not_run_is_refused(folder: Path) -> None:
    content = default_firmware().read_bytes()
    (folder / "other.elf").write_bytes(content + b"\0")
    shutil.copy(default_firmware(), folder / "same.elf")
    same = ("explain", "run.json", "--baseline", "run.json", "--firmware", "same.elf")
    assert in_process.hiltest(*same, folder=folder).returncode == 0
    refused = in_process.hiltest(*same, "--against", "other.elf", folder=folder)
    assert refused.returncode == 4
    digest = hashlib.sha256(content).hexdigest()
    assert refused.stderr == (
        f"ERROR: --against other.elf: another file was run, with the SHA-256 {digest}; name that one\n"
    )


def test_the_profile_of_a_calibrator_adds_up_to_the_cycles_of_a_run(default_run: Finished) -> None:
    profile = BoardCalibrators().profile("direct")
    assert sum(line.cycles for line in profile.lines) == profile.cycles
    assert profile.cycles - default_run.value("cycles.direct.total") == 3  # an empty call, which the run subtracts
