"""Recorded benches, whole and faulty, are judged as they were when they were recorded."""

from __future__ import annotations

import gzip
import json
from typing import Any

import pytest
from tests.finished_run import without_volatile
from tests.plugin.record_benches import BENCHES, RECORDINGS

from hiltest.campaigns.one_run import RunCommand
from hiltest.rig.bench_files import shipped

REASONS = {
    "line-lost": "lost /dev/pts/",
    "board-silent": "no answer to ",
    "nothing-answers": "and no other byte",
    "firmware-hangs": "the firmware is hung, in a branch to itself in command_average",
    "firmware-faults": "ndefined instruction",
    "stack-overflow": "stack overflow",
    "other-baud-rate": "no answer to ",
    "device-comes-back": "lost hil://",
    "output-full": "did not go out",
    "board-reset": "the board was reset",
    "brown-out": "the board was reset",
    "sensor-absent": "SENSOR_ABSENT",
    "other-sensor": "SENSOR_TIMEOUT",
    "sensor-frozen": "FXOS8700CQ accelerometer: 64 consecutive samples are identical",
    "sensor-saturated": "its y axis is at the end of its range",
    "sda-held-low": "BUS_ERROR",
    "scl-held-low": "BUS_ERROR",
}


# Processors add in different orders: a difference of headings of 3e-5 deg was seen to move by 1e-13 deg.
TOLERANCE = 1e-7
# Words, and lines of the suites, which change without a change of the judgement.
PROSE = {"sentence", "reason", "note", "place", "not_offered"}


def assert_alike(again: Any, recorded: Any, place: str = "record") -> None:
    """Assert that a record still has everything that was recorded but for its words, numbers within the tolerance.

    Keys that the recorded one lacks are newer than it, and make it not stale.
    """
    if isinstance(recorded, dict):
        assert recorded.keys() <= again.keys(), place
        for key in recorded.keys() - PROSE:
            assert_alike(again[key], recorded[key], f"{place}.{key}")
    elif isinstance(recorded, list):
        assert len(again) == len(recorded), place
        for index, value in enumerate(recorded):
            assert_alike(again[index], value, f"{place}[{index}]")
    elif isinstance(recorded, float):
        assert again == pytest.approx(recorded, rel=TOLERANCE), place
    else:
        assert again == recorded, place


def test_every_recording_is_replayed() -> None:
    assert {path.name.removesuffix(".jsonl.gz") for path in RECORDINGS.glob("*.jsonl.gz")} == set(BENCHES)


@pytest.mark.parametrize("name", BENCHES)
def test_a_recorded_bench_is_judged_as_it_was(
    name: str, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HIL_RIG")
    recorded: dict[str, Any] = json.loads(gzip.decompress((RECORDINGS / f"{name}.run.json.gz").read_bytes()))
    done = pytester.runpytest_inprocess(
        str(shipped() / "suites"),
        "--import-mode=importlib",
        f"--rootdir={pytester.path}",
        "-k",
        BENCHES[name].tests,
        "--hil-out=hil-out",
        f"--hil-replay={RECORDINGS / f'{name}.jsonl.gz'}",
        plugins=[RunCommand()],
    )
    again = json.loads((pytester.path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    del again["environment"]
    for measurement in [*again["measurements"], *recorded["measurements"]]:
        measurement["place"] = measurement["place"].partition(":")[0]  # lines of a suite move
    assert done.ret == recorded["verdict"]["exit_code"]
    assert (again["board"] or {"kind": "replay"})["kind"] == "replay"  # none, where none answered
    volatile = sorted({*recorded["volatile"], *again["volatile"]})
    assert_alike(without_volatile(again | {"volatile": volatile}), without_volatile(recorded | {"volatile": volatile}))
    if name in REASONS:
        assert any(REASONS[name] in test["reason"] for test in again["tests"])
