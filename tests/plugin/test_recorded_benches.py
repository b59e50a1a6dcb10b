"""Recorded benches, whole and faulty, are judged as they were when they were recorded."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from tests.finished_run import without_volatile

from hiltest.bench_files import shipped
from hiltest.commands.run import RunCommand

RECORDINGS = Path(__file__).parents[2] / "fixtures" / "recordings"
# What the selection was, which is an option of pytest and no part of a recording.
MAIN_JOB, AT_REST = "identity or link or cycles or heading", "identity or gravity_at_rest"
TESTS = {
    "virtual-k64f": MAIN_JOB, "virtual-k64f-harsh": MAIN_JOB, "by-hand": AT_REST, "motors": "identity or bias_is_gone",
    "line-lost": "identity or link", "line-garbled": "identity or link", "board-silent": "identity or link",
    "nothing-answers": "identity or link",
    "text-compass": "test_", "text-by-hand": "before_calibration",
    "text-skipped": "before_calibration",
    "firmware-hangs": AT_REST, "firmware-faults": AT_REST,
}  # fmt: skip
REASONS = {
    "line-lost": "lost /dev/pts/",
    "board-silent": "no answer to ",
    "nothing-answers": "only silence",
    "firmware-hangs": "the firmware is hung, looping to itself in command_average",
    "firmware-faults": "ndefined instruction",
}


def test_every_recording_is_replayed() -> None:
    assert {each.name.removesuffix(".jsonl.gz") for each in RECORDINGS.glob("*.jsonl.gz")} == set(TESTS)


@pytest.mark.parametrize("name", TESTS)
def test_a_recorded_bench_is_judged_as_it_was(
    name: str, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HIL_RIG")
    kept: dict[str, Any] = json.loads(gzip.decompress((RECORDINGS / f"{name}.run.json.gz").read_bytes()))
    done = pytester.runpytest_inprocess(
        str(shipped() / "suites"), "--import-mode=importlib", f"--rootdir={pytester.path}", "-k", TESTS[name],
        "--hil-out=hil-out", f"--hil-replay={RECORDINGS / f'{name}.jsonl.gz'}", plugins=[RunCommand()],
    )  # fmt: skip
    again = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    del again["environment"]
    assert done.ret == kept["verdict"]["exit_code"]
    assert (again["board"] or {"kind": "replay"})["kind"] == "replay"  # none, where none answered
    volatile = sorted({*kept["volatile"], *again["volatile"]})
    assert without_volatile(kept | {"volatile": volatile}) == without_volatile(again | {"volatile": volatile})
    if name in REASONS:
        assert any(REASONS[name] in each["reason"] for each in again["tests"])
