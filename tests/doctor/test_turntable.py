"""The port of a motor table, over a real pseudo-terminal with the simulated Grbl table behind it, and without one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from tests.boards.test_simulated_grbl import Bench
from tests.usb_tree import UsbTree

from hiltest.boards.simulated_grbl import GrblTable
from hiltest.boards.table_axes import TableAxes
from hiltest.doctor.check import Check, Health
from hiltest.doctor.turntable_checks import see_poses, see_turntable
from hiltest.link import grbl
from hiltest.orientation.angles import Pose
from hiltest.rig.bench_files import shipped
from hiltest.rig.rig_file import load_rig

from .conftest import held_by_a_process
from .test_examination import answering

SERVED = load_rig(shipped() / "rigs" / "served-k64f.toml")


def look(port: str, root: Path = Path("/")) -> Check:
    """Look at the table that a rig says is on a port."""
    return see_turntable(replace(SERVED, turntable=replace(SERVED.turntable, port=port)), root)


@contextmanager
def simulated_table() -> Iterator[tuple[str, Bench]]:
    """Serve the simulated table on a pseudo-terminal: its path, and the bench that it turns."""
    bench = Bench()
    table = GrblTable(TableAxes(bench), about="a test", reset=lambda: None)

    def reply(data: bytes, _baud: int) -> bytes:
        table.hear(data)
        return table.say()

    with answering(reply) as path:
        yield path, bench


def test_a_table_that_answers_is_said_with_its_state_and_is_not_turned() -> None:
    with simulated_table() as (path, bench):
        result = look(path)
    assert (result.health, result.finding) == (Health.OK, f"Grbl answers on {path}: Idle at 0, 0, 0 degrees")
    assert bench.moves == []
    assert bench.world.state_at(bench.time_s).pose == Pose(0.0, 0.0, 0.0)


def test_what_does_not_speak_grbl_is_no_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grbl, "_START_S", 0.5)  # of the 6 that an Arduino may take
    with answering(lambda data, _baud: b"$ " * len(data)) as path:
        result = look(path)
    assert result.health is Health.FAILED
    assert f"on {path}: nothing answered '?' as Grbl 1.1 does" in result.finding
    assert "port under [turntable]" in result.remedy


def test_the_process_that_holds_the_tables_port_is_named() -> None:
    with simulated_table() as (path, _bench), held_by_a_process(path) as pid:
        result = look(path)
    assert result.health is Health.FAILED
    assert f"(process {pid})" in result.finding
    assert f"kill {pid}" in result.remedy


@pytest.mark.parametrize(
    ("url", "remedy"), [("/dev/ttyACM77", "`hiltest ports` lists"), ("socket://127.0.0.1:1", "its server runs")]
)
def test_a_port_that_is_not_there_or_that_nobody_serves(url: str, remedy: str) -> None:
    result = look(url)
    assert result.health is Health.FAILED
    assert url in result.finding
    assert remedy in result.remedy


def test_a_port_that_this_user_may_not_use(as_nobody: None) -> None:
    with tempfile.TemporaryDirectory() as folder:
        tree = UsbTree(Path(folder) / "machine")
        tree.plug_in(vendor="1a86", product="7523", serial=None, name="USB Serial", tty="ttyUSB0")
        port = tree.root / "dev/ttyUSB0"
        port.chmod(0)
        result = look(str(port), tree.root)
    assert result.health is Health.FAILED
    assert "is not readable and writable" in result.finding
    assert result.remedy == f"sudo chmod a+rw {port}"


def test_a_table_that_a_hand_turns_has_no_port(tree: UsbTree) -> None:
    rig = load_rig(shipped() / "rigs" / "frdm-k64f.toml")
    result = see_turntable(rig, tree.root)
    assert result.health is Health.NOT_LOOKED_AT


@pytest.mark.parametrize("path", sorted((shipped() / "rigs").glob("*.toml")), ids=lambda path: path.stem)
def test_the_poses_of_every_shipped_rig_tell_all_known_bugs_apart(path: Path) -> None:
    check = see_poses(load_rig(path))
    # One firmware answers in whole degrees, so that this bug is no bug of it. The other leaves the soft iron, and half
    # a degree is small beside the limit of 5.
    if path.stem in ("microbit-v1", "fxos8700cq-compass"):
        assert "no bug and whole degrees" in check.finding
    else:
        assert check.health is Health.OK


@pytest.mark.parametrize("tilts", [((0.0, 0.0),), ((0.0, 0.0), (20.0, 0.0), (0.0, 20.0))])
def test_poses_without_a_tilt_about_both_axes_are_a_warning(tilts: tuple[tuple[float, float], ...]) -> None:
    rig = replace(SERVED, procedure=replace(SERVED.procedure, tilts_deg=tilts))
    check = see_poses(rig)
    assert check.health is Health.WARNING
    assert "tilts_deg" in check.remedy
