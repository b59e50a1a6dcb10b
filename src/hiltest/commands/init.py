"""``hiltest init``: copy suites, rigs, benchmarks and a first baseline for a bench of one's own, or begin a sensor."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import click

from hiltest.commands.options import documented, parsed
from hiltest.errors import ConfigError
from hiltest.session.rig_proposal import legible_name, propose_rig
from hiltest.session.settings import file_name

_FOLDERS = ("suites", "rigs", "benchmarks")
_BASELINE = Path("baselines", "virtual-k64f.json")
"""Baseline of the default rig with the packaged firmware."""
_CONFTEST = '''"""Hooks for `pytest-benchmark compare` in this folder: device cycles are shown in cycles."""

from __future__ import annotations

from hiltest.session.compare_cycles import pytest_benchmark_group_stats, pytest_benchmark_scale_unit

__all__ = ["pytest_benchmark_group_stats", "pytest_benchmark_scale_unit"]
'''
"""Equal to the file of hiltest's own repository, whose digest is in that baseline."""
_NOT_COPIED = shutil.ignore_patterns("__pycache__", ".*")


@dataclass(frozen=True, slots=True)
class Copied:
    """A bench of one's own."""

    folder: str
    """Folder of suites, rigs, benchmarks and a baseline, or of the sensor's files."""
    rig: str | None
    """Rig that was proposed for the firmware; null without one."""
    next: list[str]
    """Arguments of the next command, to be run in DIR."""


@click.command()
@documented("hiltest.init/1")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--firmware",
    metavar="ELF",
    callback=parsed(file_name),
    help="Propose a rig for this firmware, from its names and texts.",
)
@click.option("--sensor", metavar="NAME", help="Write the frame of a sensor's model into DIR, and nothing else.")
def init(folder: Path, firmware: str | None, sensor: str | None) -> tuple[int, Copied]:
    """Set up a bench: copy suites, rigs, benchmarks and a baseline.

    The files go to DIR/hil. The baseline has the numbers of the packaged firmware on the default rig.

    With --firmware, the command also writes a rig with the name of DIR. It searches the ELF for lines, packets and
    variables with a heading, a field or a calibration, and for functions to count. Uncertain ones are comments in the
    rig; at a terminal the command asks for the heading. If the ELF is for another chip than the virtual
    board's, the rig is for a real board.

    With --sensor, the command writes a module, its register table, a test that passes, and a pyproject.toml with the
    entry point that lets a rig name the sensor.
    """
    if sensor is not None:
        return _write_sensor(folder, sensor, firmware)
    from hiltest.rig.bench_files import shipped

    source, target = shipped(), folder / "hil"
    present = [target / name for name in (*_FOLDERS, _BASELINE.parent) if (target / name).exists()]
    if present:
        raise ConfigError(f"{present[0]} already exists; nothing was copied. Choose another folder, or move it away")
    proposed = None
    if firmware is not None:
        name = legible_name(folder.resolve().name)
        if (source / "rigs" / f"{name}.toml").exists():
            name += "-proposed"
        if (text := propose_rig(name, folder, Path(firmware))) is None:
            raise ConfigError(
                f"{firmware} speaks hiltest's own protocol and needs no rig of its own: "
                f"hiltest run --firmware {firmware}"
            )
        proposed = name, text
    try:
        for name in _FOLDERS:
            shutil.copytree(source / name, target / name, ignore=_NOT_COPIED)
        (target / _BASELINE).parent.mkdir()
        shutil.copyfile(source / _BASELINE, target / _BASELINE)
        if not (folder / "conftest.py").exists():  # `pytest-benchmark compare` looks there for the display of cycles
            (folder / "conftest.py").write_text(_CONFTEST, encoding="utf-8")
        if proposed is not None:
            (target / "rigs" / f"{proposed[0]}.toml").write_text(proposed[1], encoding="utf-8")
    except (OSError, shutil.Error, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"cannot copy to {target}: {reason}. Choose a writable folder") from error
    click.echo(f"suites, rigs, benchmarks and the baseline of the packaged firmware are in {target}. Next:")
    options = ["--rig", proposed[0]] if proposed else ["--baseline", str("hil" / _BASELINE)]
    click.echo(f"cd {folder} && hiltest run {' '.join(options)}")
    rig = proposed[0] if proposed else None
    return 0, Copied(str(target), rig, ["hiltest", "run", *options])


def _write_sensor(folder: Path, sensor: str, firmware: str | None) -> tuple[int, Copied]:
    from hiltest.rig.sensor_frame import write_sensor_frame

    if firmware is not None:
        raise ConfigError("--sensor and --firmware exclude each other: run hiltest init once for each")
    files = write_sensor_frame(sensor, folder)
    click.echo(f"{', '.join(file.name for file in files)} are in {folder}. Next:")
    click.echo(f"cd {folder} && python -m pytest {files[2].name} && python -m pip install -e .")
    return 0, Copied(str(folder), None, ["python", "-m", "pytest", files[2].name])
