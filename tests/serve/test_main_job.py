"""The main job over two real ports, on a machine that has other things to do."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.finished_run import run_module

from hiltest.rig.bench_files import shipped

from .conftest import Serve


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Keep as many processors busy."""
    with ExitStack() as stack:
        for _ in range(processes):
            working = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(working.kill)
        yield


def test_a_served_board_passes_the_whole_main_job_on_a_busy_machine(serve: Serve, tmp_path: Path) -> None:
    served = serve("--tcp", "0")
    text = (shipped() / "rigs" / "served-k64f.toml").read_text(encoding="utf-8")
    for written, url in (("socket://127.0.0.1:6464", served.board), ("socket://127.0.0.1:6465", served.turntable)):
        assert text.count(written) == 1
        text = text.replace(written, url)
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    with busy(os.cpu_count() or 1):
        done = run_module("hiltest", "run", "--rig", "mine.toml", folder=tmp_path)
    assert done.returncode == 0, done.stdout
    record = json.loads((tmp_path / "hil-out" / "run.json").read_text(encoding="utf-8"))
    measured = {measurement["name"]: measurement["value"] for measurement in record["measurements"]}
    # Everything that the rig limits was measured, and passed; without a calibration the board does not hold the limit.
    assert measured["fit.joint.status"] == 0
    # By the clock of a busy machine the points covered 66 %, because the board was 6 s behind; by position 92.
    assert measured["tumble.coverage"] > 85.0
    assert measured["heading.direct.max"] < 1.8 < measured["heading.uncalibrated.max_level"]
    assert record["board"]["cycle_model"] == "cortex-m4-trm/3@sram"
    assert served.end()[0] == 0
