"""``hiltest init --firmware``: the rig that is proposed for an ELF loads, and names only what is there."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.command_files import run
from tests.foreign_elf import foreign_elf
from tests.interfaces.compiled import compile_c

from hiltest.interfaces.quantities import Quantity
from hiltest.interfaces.variables import Variables
from hiltest.rig import Rig
from hiltest.rig.rig_file import load_rig
from hiltest.virtual.program.elf import load_image

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "src" / "hiltest" / "firmware"
# A compass without printf: it formats by a function of its own. What is only like a heading has names that begin so.
SOURCE = """
struct vector { float x, y, z; };
volatile struct {
  float heading_rad, target_heading;
  struct vector mag, mag_slope;
  short raw_mag[3];
  int heading_count;
} nav;
volatile float magOffset_uT[3], yaw_out;
volatile int is_calibrated;
const char *volatile format = "heading %d.%d deg, pitch/roll %d %d\\r\\n";
const char *volatile prose = "cannot compute heading %d\\r\\n";
const char *volatile field = "Mag (nT): %d,%d,%d;\\n";
__attribute__((noinline)) void magnetometer_fit(void) { nav.mag.x = nav.raw_mag[0]; }
__attribute__((noinline)) void save_calibration(void) { is_calibrated = 1; }
int main(void) { magnetometer_fit(); save_calibration(); return (int)(nav.heading_rad + magOffset_uT[1] + yaw_out); }
"""


@dataclass(frozen=True)
class Proposed:
    """A rig as `hiltest init` writes it, and what it says."""

    path: Path
    said: str

    @property
    def text(self) -> str:
        return self.path.read_text(encoding="utf-8")

    @property
    def rig(self) -> Rig:
        return load_rig(self.path)

    def paths(self) -> dict[str, list[tuple[str, str | None]]]:
        """Return path and stated type of all variables by quantity, comments as well."""
        found: dict[str, list[tuple[str, str | None]]] = {}
        for line in re.findall(r"^(?:# )?(\w+ = \{ path = .*\}) +# ", self.text, re.M):
            ((name, value),) = tomllib.loads(line).items()
            found.setdefault(name, []).append((value["path"], value.get("type")))
        return found


@pytest.fixture
def propose(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Proposed]:
    """Return a function that lets `hiltest init` propose a rig for an ELF."""

    def proposed(elf: Path, name: str = "mycompass") -> Proposed:
        assert run("init", str(tmp_path / name), "--firmware", str(elf)) == 0
        (path,) = set((tmp_path / name / "hil" / "rigs").iterdir()) - {
            tmp_path / name / "hil" / "rigs" / each.name for each in (ROOT / "hil" / "rigs").iterdir()
        }
        return Proposed(path, capsys.readouterr().out)

    return proposed


@pytest.fixture
def compass(tmp_path: Path, require_tool: Callable[[str], str]) -> Path:
    (tmp_path / "build").mkdir()
    return compile_c(require_tool("arm-none-eabi-gcc"), tmp_path / "build", SOURCE)


def assert_all_paths_lead_to_their_quantity(proposed: Proposed, elf: Path) -> None:
    variables = Variables(load_image(elf))
    for name, several in proposed.paths().items():
        for path, type_ in several:
            assert len(variables.place(path, type_=type_).scalars) == Quantity.named(name).size, path


def test_lines_without_a_unit_are_proposed_and_the_world_is_that_of_a_rig_that_ships(
    propose: Callable[..., Proposed],
) -> None:
    proposed = propose(SAMPLES / "compass-lines.elf")
    rig, shipped = proposed.rig, load_rig(ROOT / "hil" / "rigs" / "text-compass.toml")
    assert "hiltest run --rig mycompass" in proposed.said
    assert rig.device is not None
    assert rig.device.text is not None
    assert rig.device.kind == "text"
    assert set(rig.device.text.values) == {"heading", "pitch", "roll"}
    assert (rig.world, rig.field, rig.sensors, rig.procedure) == (
        shipped.world,
        shipped.field,
        shipped.sensors,
        shipped.procedure,
    )
    assert [*rig.cycles][:2] == ["background_take", "tilt_heading"], "the busiest first"
    assert {"quadric_fit", "magnetometer_direct", "mag3110_read", "fit_nothing"} & set(rig.cycles) == {"quadric_fit"}
    assert re.search(r"^  # '.*RAW=.*P<magnetometer>.*uT\?", proposed.text, re.M), "a guess is a comment"
    assert ("background.iron.hard_iron", None) in proposed.paths()["hard_iron"]
    assert ("background.iron.error_percent", None) in proposed.paths()["fit_error"]
    assert_all_paths_lead_to_their_quantity(proposed, SAMPLES / "compass-lines.elf")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["compass-lines.elf", "nxp_sensor_fusion.elf"])
def test_the_board_is_understood_by_the_rig(
    name: str, propose: Callable[..., Proposed], capsys: pytest.CaptureFixture[str]
) -> None:
    proposed = propose(SAMPLES / name if (SAMPLES / name).exists() else foreign_elf(name))
    assert run("listen", "--rig", str(proposed.path), "--seconds", "2.2") == 0
    said = capsys.readouterr().out
    assert re.search(r"^\d+ understood, 0 not", said, re.M)
    assert re.search(r"^heading +[1-9]", said, re.M)


def test_nxp_s_fusion_is_known_with_its_variables_and_functions(propose: Callable[..., Proposed]) -> None:
    elf = foreign_elf("nxp_sensor_fusion.elf")
    proposed = propose(elf)
    rig, paths = proposed.rig, proposed.paths()
    assert rig.device is not None
    assert (rig.device.kind, rig.device.fsflk.release) == ("fsflk", "7")
    assert rig.world == load_rig(ROOT / "hil" / "rigs" / "nxp-fusion-agm01.toml").world
    assert ("sfg.SV_9DOF_GBY_KALMAN.fRhoPl", None) in paths["heading"]
    assert [paths[each][0][0] for each in ("hard_iron", "inverse_soft_iron", "calibrated")] == [
        "sfg.MagCal.fV",
        "sfg.MagCal.finvW",
        "sfg.MagCal.iValidMagCal",
    ]
    assert {"fRun_9DOF_GBY_KALMAN", "fInvertMagCal", *(f"fUpdateMagCalibration{n}Slice" for n in (4, 7, 10))} <= set(
        rig.cycles
    )
    assert_all_paths_lead_to_their_quantity(proposed, elf)


@pytest.mark.parametrize("name", ["compass-packets.elf", "riot_fxos8700.elf", "z_hello.elf", "nxp_shell.elf"])
def test_without_a_heading_no_language_is_claimed(name: str, propose: Callable[..., Proposed]) -> None:
    elf = SAMPLES / name if (SAMPLES / name).exists() else foreign_elf(name)
    proposed = propose(elf)
    assert proposed.rig.device is None
    assert "none of them is certainly a heading: fill in [device]" in proposed.said
    assert_all_paths_lead_to_their_quantity(proposed, elf)
    if name == "riot_fxos8700.elf":
        (pattern,) = re.findall(r"^#   '(.*magnetic field.*)', +# ", proposed.text, re.M)
        found = re.search(pattern, "magnetic field: (-120, 3, 40)")
        assert found is not None
        assert found["magnetometer"] == "-120, 3, 40"


def test_a_format_of_printf_becomes_an_expression_that_finds_its_numbers(
    compass: Path, propose: Callable[..., Proposed]
) -> None:
    proposed = propose(compass)
    rig = proposed.rig
    assert rig.device is not None
    assert rig.device.text is not None
    heading, field = rig.device.text.patterns
    assert "cannot" not in proposed.text, "a label in a sentence is prose"
    found = re.search(heading, "t=3 heading 123.4 deg, pitch/roll 5 6")
    assert found is not None
    assert found["heading"] == "123.4"
    found = re.search(field, "Mag (nT): -21003,5,40100;")
    assert found is not None
    assert found["magnetometer"] == "-21003,5,40100"
    units = {name: each.unit for name, each in rig.device.text.values.items()}
    assert units == {"heading": "deg", "magnetometer": "nT"}
    assert "roll" not in rig.device.text.values, "the label before two numbers is not that of one"


def test_a_heading_in_a_variable_is_read_from_memory(
    tmp_path: Path, require_tool: Callable[[str], str], propose: Callable[..., Proposed]
) -> None:
    elf = compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, SOURCE.replace("heading %d", "state %d"))
    proposed = propose(elf)
    rig, paths = proposed.rig, proposed.paths()
    assert rig.device is not None
    assert rig.device.memory is not None
    assert rig.device.kind == "memory"
    assert {name: (each.path, each.unit) for name, each in rig.device.memory.values.items()} == {
        "heading": ("nav.heading_rad", "rad"),
        "hard_iron": ("magOffset_uT", "uT"),
        "calibrated": ("is_calibrated", None),
    }
    assert [path for path, _ in paths["heading"]] == ["nav.heading_rad", "yaw_out"]
    assert [path for path, _ in paths["magnetometer"]] == ["nav.mag", "nav.raw_mag"]
    assert set(rig.cycles) == {"magnetometer_fit"}, "what saves a calibration is not worth counting"
    assert_all_paths_lead_to_their_quantity(proposed, elf)


def test_without_debug_information_types_are_guessed_by_size_and_stay_comments(
    tmp_path: Path, require_tool: Callable[[str], str], propose: Callable[..., Proposed]
) -> None:
    compiler = require_tool("arm-none-eabi-gcc")
    elf = compile_c(compiler, tmp_path, "volatile float heading; int main(void) { return heading; }")
    subprocess.run([compiler.replace("gcc", "strip"), "--strip-debug", str(elf)], check=True, timeout=60)
    proposed = propose(elf)
    assert proposed.rig.device is None
    assert proposed.paths() == {"heading": [("heading", "float")]}
    assert "none of them is certainly a heading" in proposed.said
    assert "no debug information" in proposed.text
    assert_all_paths_lead_to_their_quantity(proposed, elf)
    subprocess.run([compiler.replace("gcc", "strip"), str(elf)], check=True, timeout=60)
    assert propose(elf, "stripped").paths() == {}


def test_the_rig_finds_the_firmware_from_anywhere_and_takes_no_name_of_another(
    compass: Path, propose: Callable[..., Proposed]
) -> None:
    proposed = propose(compass, "text-compass")
    assert proposed.path.name == "text-compass-proposed.toml"
    assert 'firmware = "../../../build/program.elf"' in proposed.text
    assert proposed.rig.board.firmware is not None
    assert (proposed.path.parent / proposed.rig.board.firmware).resolve() == compass
    assert propose(compass, 'my "compass" 2').path.name == "my-compass-2.toml"


def answered(folder: Path, elf: Path, answers: str) -> tuple[Rig, str]:
    """Return the rig that answers at a terminal lead to, and what was said there."""
    ours, theirs = pty.openpty()
    os.write(ours, answers.encode())
    with subprocess.Popen(
        [sys.executable, "-m", "hiltest", "init", "asked", "--firmware", str(elf)],
        cwd=folder,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
    ) as process:
        os.close(theirs)
        said = ""
        with suppress(OSError):  # its end is closed
            while piece := os.read(ours, 4096):
                said += piece.decode()
        os.close(ours)
    assert process.returncode == 0, said
    return load_rig(folder / "asked" / "hil" / "rigs" / "asked.toml"), said


@pytest.mark.slow
def test_at_a_terminal_it_asks_which_is_the_heading_and_for_its_unit(compass: Path, tmp_path: Path) -> None:
    # From variables; there is no heading 5; then yaw_out, in rad.
    rig, said = answered(tmp_path, compass, "2\n5\n2\n2\n")
    device = rig.device
    assert "Answer with a number from 1 to 3." in said
    assert device is not None
    assert device.memory is not None
    assert device.kind == "memory"
    assert (device.memory.values["heading"].path, device.memory.values["heading"].unit) == ("yaw_out", "rad")
    assert "magnetometer" not in device.memory.values


@pytest.mark.slow
def test_enter_at_every_question_gives_the_rig_of_a_run_without_a_terminal(
    tmp_path: Path, propose: Callable[..., Proposed]
) -> None:
    rig, said = answered(tmp_path, SAMPLES / "compass-lines.elf", "\n")
    assert said.count("[1] ") == 1, "only the unit of the heading is open"
    assert "HDG=123.4" in said
    assert rig.device == propose(SAMPLES / "compass-lines.elf").rig.device


@pytest.mark.parametrize(
    ("names", "used"),
    [
        (("magOffset_uT", "softIron"), set()),
        (("magOffset_uT", "invSoftIron"), {"hard_iron", "inverse_soft_iron"}),
        (("magOffset", "invSoftIron"), set()),
    ],
)
def test_a_calibration_is_used_as_a_whole_or_not_at_all(
    names: tuple[str, str],
    used: set[str],
    tmp_path: Path,
    require_tool: Callable[[str], str],
    propose: Callable[..., Proposed],
) -> None:
    iron, matrix = names
    source = f"volatile float heading_deg, {iron}[3], {matrix}[9];"
    source += f"int main(void) {{ return (int)(heading_deg + {iron}[0] + {matrix}[0]); }}"
    device = propose(compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, source)).rig.device
    assert device is not None
    assert device.memory is not None
    assert set(device.memory.values) == {"heading", *used}


@pytest.mark.slow
def test_nxp_s_fusion_has_the_sensors_of_its_shield_by_its_variables_as_well(tmp_path: Path) -> None:
    rig, _ = answered(tmp_path, foreign_elf("nxp_sensor_fusion.elf"), "2\n5\n" + "\n" * 12)
    shipped = load_rig(ROOT / "hil" / "rigs" / "nxp-fusion-agm01.toml")
    assert (rig.sensors, rig.world) == (shipped.sensors, shipped.world)
    assert rig.device is not None
    assert rig.device.memory is not None
    assert rig.device.memory.values["heading"].path == "sfg.SV_9DOF_GBY_KALMAN.fRhoPl"


@pytest.mark.parametrize("machine", ["x86-64", "hiltest's own protocol", "text"])
def test_what_needs_no_rig_or_is_no_firmware_is_refused_before_anything_is_copied(
    machine: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = bytearray((SAMPLES / "hiltest-frdm-k64f.elf").read_bytes())
    if machine == "x86-64":
        content[18:20] = (62).to_bytes(2, "little")  # e_machine
    (tmp_path / "app.elf").write_bytes(b"text" if machine == "text" else content)
    assert run("init", str(tmp_path / "bench"), "--firmware", str(tmp_path / "app.elf")) == 4
    said = capsys.readouterr().err
    assert {"x86-64": "EM_X86_64", "text": "not a complete ELF"}.get(machine, "own protocol") in said
    assert not (tmp_path / "bench").exists()


@pytest.mark.parametrize("hostile", [b'yaw"]=#', b'x"]=yaw', b"yaw'\n[x", b"yaw\xff\x7fab", b"yaw\\u00", b"'''%s%n"])
def test_names_and_texts_that_would_break_the_file_do_not(
    hostile: bytes, compass: Path, propose: Callable[..., Proposed]
) -> None:
    compass.write_bytes(compass.read_bytes().replace(b"heading", hostile))
    proposed = propose(compass)
    assert proposed.rig.name == "mycompass"
    assert_all_paths_lead_to_their_quantity(proposed, compass)


def test_types_within_types_without_end_do_not_hold_it_up(
    tmp_path: Path, require_tool: Callable[[str], str], propose: Callable[..., Proposed]
) -> None:
    nested = "struct t0 {};" + "".join(
        f"struct t{n} {{ struct t{n - 1} {', '.join(f'm{k}' for k in range(20))}; }};" for n in range(1, 7)
    )  # 20 to the power of 6 members, of no bytes
    source = f"{nested} volatile struct t6 root; volatile float heading; int main(void) {{ return heading; }}"
    proposed = propose(compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, source))
    assert "more than 20000 variables and members" in proposed.text
    assert proposed.rig.device is not None


def test_the_copied_baseline_has_the_digest_of_the_copied_hooks(tmp_path: Path) -> None:
    assert run("init", str(tmp_path)) == 0
    hooks = (ROOT / "conftest.py").read_bytes()  # the baseline is saved in that folder
    assert (tmp_path / "conftest.py").read_bytes() == hooks
