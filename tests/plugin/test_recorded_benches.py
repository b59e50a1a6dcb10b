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
    "firmware-hangs": "the firmware is hung, looping to itself in command_average",
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


def assert_alike(again: Any, kept: Any, place: str = "record") -> None:
    """Assert that two records say the same but for their words, numbers within the tolerance."""
    if isinstance(kept, dict):
        assert again.keys() == kept.keys(), place
        for key in kept.keys() - PROSE:
            assert_alike(again[key], kept[key], f"{place}.{key}")
    elif isinstance(kept, list):
        assert len(again) == len(kept), place
        for index, value in enumerate(kept):
            assert_alike(again[index], value, f"{place}[{index}]")
    elif isinstance(kept, float):
        assert again == pytest.approx(kept, rel=TOLERANCE), place
    else:
        assert again == kept, place


def test_every_recording_is_replayed() -> None:
    assert {each.name.removesuffix(".jsonl.gz") for each in RECORDINGS.glob("*.jsonl.gz")} == set(BENCHES)


@pytest.mark.parametrize("name", BENCHES)
def test_a_recorded_bench_is_judged_as_it_was(
    name: str, pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("HIL_RIG")
    kept: dict[str, Any] = json.loads(gzip.decompress((RECORDINGS / f"{name}.run.json.gz").read_bytes()))
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
    assert done.ret == kept["verdict"]["exit_code"]
    assert (again["board"] or {"kind": "replay"})["kind"] == "replay"  # none, where none answered
    volatile = sorted({*kept["volatile"], *again["volatile"]})
    assert_alike(without_volatile(again | {"volatile": volatile}), without_volatile(kept | {"volatile": volatile}))
    if name in REASONS:
        assert any(REASONS[name] in each["reason"] for each in again["tests"])
