"""Which suites and rigs are used: the working tree's before the shipped ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from hiltest.errors import ConfigError
from hiltest.rig.bench_files import rig_file, shipped, suites


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A working tree with a rig and a suite folder of its own."""
    for name in ("virtual-k64f.toml", "mine.toml"):
        path = tmp_path / "hil" / "rigs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    (tmp_path / "hil" / "suites").mkdir()
    return tmp_path


def test_local_suites_and_rigs_come_first(bench: Path) -> None:
    assert suites(bench) == bench / "hil" / "suites"
    assert rig_file(bench, None) == bench / "hil" / "rigs" / "virtual-k64f.toml"
    assert rig_file(bench, "virtual-k64f") == bench / "hil" / "rigs" / "virtual-k64f.toml"


def test_elsewhere_the_shipped_ones_are_used(tmp_path: Path) -> None:
    assert suites(tmp_path) == shipped() / "suites"
    assert rig_file(tmp_path, None) == shipped() / "rigs" / "virtual-k64f.toml"
    assert rig_file(tmp_path, "frdm-k64f.toml") == shipped() / "rigs" / "frdm-k64f.toml"


def test_a_path_means_that_file_and_no_other(bench: Path) -> None:
    assert rig_file(bench, "hil/rigs/mine.toml") == bench / "hil" / "rigs" / "mine.toml"
    assert rig_file(bench, str(bench / "hil" / "rigs" / "mine.toml")) == bench / "hil" / "rigs" / "mine.toml"
    with pytest.raises(ConfigError, match=r"no rig file 'other/mine\.toml'"):
        rig_file(bench, "other/mine.toml")


def test_a_rig_that_is_not_there_lists_those_that_are(bench: Path) -> None:
    with pytest.raises(ConfigError, match=r"rigs here: frdm-k64f, (.*, )?mine, (.*, )?virtual-k64f"):
        rig_file(bench, "gone")
