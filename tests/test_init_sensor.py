"""``hiltest init --sensor``: a plugin whose test passes as written, and which a rig can name."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from tests.command_files import run
from tests.parts_on_buses import parts_on_buses

from hiltest.errors import ConfigError
from hiltest.measurement import sensor_registers
from hiltest.rig import build_world, parts
from hiltest.rig.rig_file import load_rig

RIG = Path(__file__).parents[1] / "hil" / "rigs" / "text-compass.toml"


@pytest.mark.slow  # starts pytest
def test_the_frame_of_a_sensor_passes_its_test_as_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("init", str(tmp_path / "mine"), "--sensor", "ak8963") == 0
    assert "python -m pytest test_ak8963.py" in capsys.readouterr().out
    names = sorted(path.name for path in (tmp_path / "mine").iterdir())
    assert names == ["ak8963.py", "ak8963.toml", "pyproject.toml", "test_ak8963.py"]
    command = [sys.executable, "-m", "pytest", "-q", "-W", "error", "-p", "no:cacheprovider", "test_ak8963.py"]
    done = subprocess.run(command, cwd=tmp_path / "mine", capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 passed" in done.stdout


@pytest.fixture
def installed_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A rig with the sensor of a frame, found as an installation would, without a network."""
    assert run("init", str(tmp_path), "--sensor", "ak8963") == 0
    project = tomllib.loads((tmp_path / "pyproject.toml").read_text())["project"]
    ((group, entries),) = project["entry-points"].items()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "ak8963", raising=False)
    installed = [EntryPoint(name, value, group) for name, value in entries.items()]
    for module in (parts, sensor_registers):
        monkeypatch.setattr(module, "entry_points", lambda *, group: [row for row in installed if row.group == group])
    file = tmp_path / "rig.toml"
    file.write_text(f'{RIG.read_text()}\n[[sensors.parts]]\npart = "ak8963"\ninterrupts = {{ DRDY = "PTC5" }}\n')
    return file


@pytest.mark.parametrize(
    ("file", "old", "new", "reason"),
    [
        ("ak8963.py", "class Ak8963(TableSensor)", "class Ak8963", "is no subclass of TableSensor"),
        ("ak8963.py", "import Sensed", "import Felt", "cannot be imported, ImportError"),
        (
            "ak8963.toml",
            'register = "OUT_X_L"',
            'register = "OUT"',
            "cannot be imported, ConfigError: .*no register table",
        ),
    ],
)
def test_a_mistake_in_a_plugin_is_named_with_the_rig_s_line(
    installed_rig: Path, file: str, old: str, new: str, reason: str
) -> None:
    source = installed_rig.with_name(file)
    text = source.read_text()
    assert old in text
    source.write_text(text.replace(old, new))
    with pytest.raises(ConfigError, match=rf"rig\.toml:\d+: sensors\.parts\.0\.part: .*{reason}"):
        load_rig(installed_rig)


def test_a_rig_names_a_sensor_by_its_entry_point(installed_rig: Path) -> None:
    rig = load_rig(installed_rig)
    part = parts_on_buses(rig, build_world(rig), seed=1)["i2c1"][-1]
    assert (type(part).__name__, part.address) == ("Ak8963", 0x30)
    assert sensor_registers.registers_of.__wrapped__("AK8963")[0x02].name == "CONTROL"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("AK8963", "the name becomes a module"),
        ("lis3mdl", "hiltest has this part already"),
        ("class", "Python has a word or a module of this name"),
        ("math", "Python has a word or a module of this name"),
        ("mag3110", "hiltest has this part already"),
    ],
)
def test_a_name_that_cannot_be_is_refused(
    tmp_path: Path, name: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("init", str(tmp_path), "--sensor", name) == 4
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "ak8963.toml").write_text("mine")
    assert run("init", str(tmp_path), "--sensor", "ak8963") == 4
    assert "already exists; nothing was written" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["ak8963.toml"]
    assert run("init", str(tmp_path), "--sensor", "ak8975", "--firmware", "some.elf") == 4
    assert "exclude each other" in capsys.readouterr().err
