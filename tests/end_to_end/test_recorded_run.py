"""The main job, recorded and replayed: the same record, without a board."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.finished_run import run_hiltest, without_volatile

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
