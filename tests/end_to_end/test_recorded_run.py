"""The main job, recorded and replayed: the same record, or the same contradiction, without a board."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.finished_run import run_hiltest, without_volatile

from .firmware_edits import Edit, FirmwareCopy

pytestmark = pytest.mark.slow


def test_the_whole_run_on_the_default_rig_is_the_same_from_its_recording(tmp_path: Path) -> None:
    for name in ("bench", "desk"):
        (tmp_path / name).mkdir()
    recorded = run_hiltest(tmp_path / "bench", "--record", "run.jsonl.gz")
    assert recorded.code == 0, recorded.output + recorded.errors
    replayed = run_hiltest(tmp_path / "desk", "--replay", str(tmp_path / "bench" / "run.jsonl.gz"))
    assert replayed.code == 0, replayed.output + replayed.errors
    first, again = recorded.record, replayed.record
    assert len(first["measurements"]) > 200
    volatile = sorted({*first["volatile"], *again["volatile"]})
    assert without_volatile(first | {"volatile": volatile}) == without_volatile(again | {"volatile": volatile})


@pytest.mark.ci
@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (
            Edit("app/vector_statistics.c", "(float)statistics->count;", "(float)statistics->count + 0.5f;"),
            "the firmware contradicts the board: the firmware's mean of",
        ),
        (
            Edit("app/timed_run.c", "cost.cycles = total - cost.overhead_cycles; /*", "cost.cycles = total / 2u; /*"),
            "the firmware contradicts the board: it reports",
        ),
    ],
    ids=["mean", "cycles"],
)
def test_a_contradiction_is_named_the_same_from_the_recording(
    copy_of_the_firmware: FirmwareCopy, tmp_path: Path, edit: Edit, message: str
) -> None:
    elf = copy_of_the_firmware.build(edit, tmp_path / "edited.elf")
    chosen = ("--poses", "level", "--", "-k", "identity or heading or cycles")
    for name in ("bench", "desk"):
        (tmp_path / name).mkdir()
    recorded = run_hiltest(tmp_path / "bench", "--firmware", str(elf), "--record", "run.jsonl.gz", *chosen)
    replayed = run_hiltest(tmp_path / "desk", "--replay", str(tmp_path / "bench" / "run.jsonl.gz"), *chosen)
    assert recorded.code == replayed.code == 1, replayed.output + replayed.errors
    reasons, again = ({test["id"]: test["reason"] for test in run.record["tests"]} for run in (recorded, replayed))
    assert any(message in reason for reason in reasons.values())
    assert again == reasons
