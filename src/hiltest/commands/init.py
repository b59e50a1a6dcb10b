"""``hiltest init``: suites, rigs, benchmarks and a first baseline for a bench of one's own."""

from __future__ import annotations

import shutil
from pathlib import Path

import click

from hiltest.bench_files import shipped
from hiltest.errors import ConfigError

_FOLDERS = ("suites", "rigs", "benchmarks")
_BASELINE = Path("baselines", "virtual-k64f.json")
"""Baseline of the default rig with the packaged firmware."""
_CONFTEST = '''"""What `pytest-benchmark compare` finds in this folder: device cycles are shown in cycles."""

from hiltest.compare_cycles import pytest_benchmark_group_stats, pytest_benchmark_scale_unit  # noqa: F401
'''
_NOT_COPIED = shutil.ignore_patterns("__pycache__", ".*")


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path, file_okay=False))
def init(folder: Path) -> int:
    """Copy suites, rigs, benchmarks and a baseline to DIR/hil.

    The baseline holds the numbers of the packaged firmware on the default rig.
    """
    source, target = shipped(), folder / "hil"
    present = [target / name for name in (*_FOLDERS, _BASELINE.parent) if (target / name).exists()]
    if present:
        raise ConfigError(f"{present[0]} is already there; nothing was copied. Choose another folder, or move it away")
    try:
        for name in _FOLDERS:
            shutil.copytree(source / name, target / name, ignore=_NOT_COPIED)
        (target / _BASELINE).parent.mkdir()
        shutil.copyfile(source / _BASELINE, target / _BASELINE)
        if not (folder / "conftest.py").exists():  # there `pytest-benchmark compare` looks for what shows cycles
            (folder / "conftest.py").write_text(_CONFTEST, encoding="utf-8")
    except (OSError, shutil.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot copy to {target}: {reason}. Choose a folder that can be written to") from error
    click.echo(f"suites, rigs, benchmarks and the baseline of the packaged firmware are in {target}. Next:")
    click.echo(f"cd {folder} && hiltest run --baseline {'hil' / _BASELINE}")
    return 0
