"""Mistakes of a first user, each a command line: the exit code, and the place and the remedy that the error names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.in_process import hiltest
from tests.log_fitting.recording import six_faces_and_turns, write

from hiltest.boards.bench import default_firmware
from hiltest.procedures.golden_points import golden_points
from hiltest.rig.bench_files import shipped

LONG_NAME = "x" * 300
RIGS = {
    "key": ("strength_ut", "strenght_ut"),
    "nanotesla": ("strength_ut = 48.5", "strength_ut = 48500"),
    "quoted": ("strength_ut = 48.5", 'strength_ut = "48.5"'),
    "twice": ("strength_ut = 48.5", "strength_ut = = 48.5"),
    "part": ("[field]", '[[sensors.parts]]\npart = "lsm303ag"\n\n[field]'),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with logs, firmware, sources, rigs and other files, good ones and bad ones."""
    folder = tmp_path_factory.mktemp("mistakes")
    points = "\n".join(",".join(f"{value:.1f}" for value in point) for point in golden_points(400) / 10.0)
    texts = {
        "good.csv": f"mx_uT,my_uT,mz_uT\n{points}\n",
        "short-row.csv": "mx_uT,my_uT,mz_uT\n1,2,3\n1,2\n4,5,6\n",
        "word.csv": "mx_uT,my_uT,mz_uT\n1,2,3\n1,oops,3\n4,5,6\n",
        "empty.csv": "",
        "notes.md": "# Notes\n\nBuy milk.\n",
        "mine.c": "int calibrate(void) { return 0; }\n",
        "mine.py": "def calibrate(samples):\n    return None\n",
        "other.json": "{}",
    }
    rig = (shipped() / "rigs" / "virtual-k64f.toml").read_text(encoding="utf-8")
    for name, (good, bad) in RIGS.items():
        assert good in rig
        texts[f"{name}.toml"] = rig.replace(good, bad, 1)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    write(folder / "imu.csv", *six_faces_and_turns().readings())
    (folder / "photo.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    (folder / "sheet.xlsx").write_bytes(b"PK\x03\x04" + bytes(200))
    (folder / "mine.elf").write_bytes(default_firmware().read_bytes())
    (folder / "image.bin").write_bytes(default_firmware().read_bytes()[4096:8192])
    (folder / "empty").mkdir()
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    rows = np.column_stack([21.0 * np.cos(turn) + 5.0, 20.0 * np.sin(turn), 0.0 * turn + 40.0])
    np.savetxt(folder / "turn.csv", rows, fmt="%.1f", delimiter=",", header="mx_uT,my_uT,mz_uT", comments="")
    return folder


def files_of(folder: Path) -> list[Path]:
    """Return the files in a folder; Python may keep the code of a calibrator that it imported."""
    return sorted(path for path in folder.rglob("*") if path.is_file() and path.parent.name != "__pycache__")


def mistakes(text: str) -> Iterator[pytest.ParameterSet]:
    """Yield words and named texts of each line ``COMMAND LINE => named | named``."""
    for line in text.strip().splitlines():
        words, named = line.split(" => ")
        yield pytest.param(words.split(), named.split(" | "), id=words[:60])


COMMANDS = """
dance => No such command 'dance'
test => No such command 'test'. Did you mean 'run'?
ci => No such command 'ci'. Did you mean 'start'?
studdy => Did you mean 'study'?
stduy estimators => Did you mean 'study'?
calibrat => Did you mean 'calibrate'?
profil worse => 'profil' | Did you mean 'profile worst'?
fit-noise good.csv => Did you mean 'fit noise'?
baseline sav empty x.json => Did you mean 'save'?
fit good.csv good.csv => unexpected extra argument (good.csv)
doctor key.toml => unexpected extra argument (key.toml)
ports --jason => '--jason' | '--json'
doctor --prot x => '--port'
listen --port /dev/gone => '--rig'
bisect HEAD => 'BAD'
compare other.json => NEW
report => 'DIR|FILE'
init empty --sensor => '--sensor'
"""
RUNS = f"""
run --sed 1 => '--sed' | '--seed'
run --prot /dev/gone => '--port'
run --seed x => '--seed': 'x' is not a seed
run --seeds 9..1 => '9..1' | 1..100
run --seeds 5 => '5' is not a range of seeds | 1..100
run --seeds 1..4294967296 => '4294967296' is not a seed
run --seeds 1..2 --seed 1 => leave out --seed and --port
run --seeds 1..2 --port /dev/ttyACM0 => leave out --seed and --port
run --may-fail 2 => --may-fail | --seeds
run --jobs 2 => --jobs | --seeds
run --suite fulll => '--suite' | Did you mean 'full'?
run --poses lvel => '--poses' | Did you mean 'level'?
run --out {LONG_NAME} => a name of 300 bytes | at most 255 bytes
run --out= => '--out': the name is empty
run --rig= => '--rig': the name is empty
run -k heading => '-k' | hiltest run -- -k heading
run gone.elf => gone.elf: No such file
run gone.elf --firmware other.elf => --firmware other.elf | gone.elf | leave one out
run mine.elf mine.elf => two firmwares | --against
run good.csv => good.csv | hiltest fit good.csv
run mine.c => mine.c | hiltest judge mine.c
run key.toml => --rig key.toml
report {LONG_NAME} => no file can have this name
"""
STUDIES = """
study => 'NAME' | estimators
study estimator => 'estimator' | Did you mean 'estimators'?
study orbits => 'orbits' | 'ellipsoids'
study estimators --point 10 => '--point' | '--points'
study ellipsoids --points 9 => '--points' | 9
study ellipsoids --jobs 0 => '--jobs'
study ellipsoids --seed x => '--seed' | 'x'
study ellipsoids --instances 0 => '--instances'
study ellipsoids --noise 1 => --noise | choose
study choose --coverage 0 => '--coverage'
study choose --coverage 0.5 => '--coverage' | write 50 for percent
study choose --points 10001 => 10000 points
study choose --firmware good.csv => good.csv: not a complete ELF file
study choose --firmware gone.elf => gone.elf: No such file
study dpi --points 50 => dpi | --points
study estimators --calibrator tubin => 'tubin' | did you mean 'taubin'?
"""
LOGS = """
fit => 'LOG'
fit gone.csv => gone.csv: No such file
fit empty.csv => empty.csv: the file is empty
fit photo.png => photo.png:1 | binary file
fit sheet.xlsx => sheet.xlsx:1 | binary file
fit mine.elf => mine.elf:1 | binary file
fit notes.md => notes.md | magnetometer | Buy, milk
fit word.csv => word.csv:3 | my_uT | 'oops'
fit short-row.csv => short-row.csv:3 | 2 cells
fit empty => empty has no log of a magnetometer
fit good.csv --columns a,b,c => --columns | 'a' | mx_uT, my_uT, mz_uT
fit good.csv --columns 1,2,9 => --columns | '9'
fit good.csv --with temperature => --with | 'temperature'
fit good.csv --unit ut => '--unit' | Did you mean 'uT'?
fit good.csv --shape sphare => '--shape' | Did you mean 'sphere'?
fit good.csv --on hots => '--on' | Did you mean 'host'?
fit good.csv --at-least god => '--at-least' | Did you mean 'good'?
fit good.csv --calibrator kalman => 'kalman' | direct
fit good.csv --calibrator gauss => 'gauss' | did you mean 'gauss-newton'?
fit good.csv --calibrator taubin => 'taubin' | --on host
fit good.csv --calibrator tobin --on host => 'tobin' | did you mean 'taubin'?
fit good.csv --on host --firmware mine.elf => --firmware | --on host
fit good.csv --firmware gone.elf => gone.elf
fit good.csv --on host --export-json gone/c.json => gone/c.json
fit good.csv --on host --at 48.1 => --at 48.1 | 48.1,11.6,2026-05-01
fit good.csv --on host --at 148.1,11.6,2026-05-01 => --at 148.1 | latitude
fit good.csv --on host --at 48.1,11.6,1803-05-01 => --at | 1803
fit good.csv --from 9 --to 1 => from 9 to 1 | from 1 to 400
fit good.csv --steady --from 1 => --steady | --from
fit turn.csv --shape circle --calibrator direct => --shape circle | --calibrator
fit turn.csv --unit counts --field 20 => field | --unit
fit imu.csv --shape sphere => --shape | hiltest fit imu
fit imu good.csv => accelerometer | --accelerometer-columns
fit noise good.csv => gyroscope | --columns
decode gone.bin => gone.bin | serial port
play --rig virtual-k64f good.csv => unexpected extra argument (good.csv)
play --rig virtual-k64f --recording gone.npz => 'gone.npz'
"""
FIRMWARE = """
judge => FILE | --init
judge gone.c => gone.c: No such file
judge notes.md => notes.md | module.py:function
judge mine.py => mine.py:calibrate
judge mine.py:calibrat => 'calibrat'
judge mine.elf --function calibrat => 'calibrat' | calibrate
judge mine.py:calibrate --limit bound => --limit bound | bound.p99=1.5
profile mine.elf => 'FUNCTION'
profile mine.elf fit_pair => 'fit_pair' | fit_pairs
profile image.bin main => image.bin | 'main' | stripped
profile good.csv main => good.csv: not a complete ELF file
flash gone.elf => gone.elf: No such file
flash image.bin => image.bin | vector table
start gone.elf => gone.elf | hiltest start FILE
start good.csv => good.csv: not a complete ELF file
init mine.elf => 'mine.elf' is a file
"""
RECORDS = """
report gone => gone: No such file
report good.csv => good.csv: not JSON
report empty => empty has no record of a run
report other.json => other.json: schema is null | hiltest.run/1
report trend gone => gone: no such folder
report trend empty => empty has no run
report export empty --format benchr => '--format' | Did you mean 'bencher'?
compare other.json gone.json => gone.json: No such file
baseline save empty x.json => empty has no record
explain gone => gone: No such file
"""
BENCHES = """
doctor --rig gone => 'gone' | virtual-k64f
doctor --rig mine.elf => mine.elf | TOML
serve --rig key.toml => key.toml:12 | 'strenght_ut' | did you mean 'strength_ut'?
serve --rig nanotesla.toml => nanotesla.toml:12 | field.strength_ut | 48.5 uT
serve --rig quoted.toml => quoted.toml:12 | field.strength_ut | "48.5"
serve --rig twice.toml => twice.toml:12 | not TOML
serve --rig part.toml => sensors.parts.0.part | did you mean 'lsm303agr'?
calibrate --port /dev/gone => '/dev/gone' | --port
"""


@pytest.mark.parametrize(
    ("words", "named"),
    [mistake for text in (COMMANDS, RUNS, STUDIES, LOGS, FIRMWARE, RECORDS, BENCHES) for mistake in mistakes(text)],
)
def test_a_mistake_ends_with_4_names_its_place_and_leaves_nothing_behind(
    folder: Path, words: list[str], named: list[str]
) -> None:
    before = files_of(folder)
    done = hiltest(*words, folder=folder)
    assert done.returncode == 4, done.stdout + done.stderr
    (error,) = (line for line in done.stderr.splitlines() if line.startswith("ERROR: "))
    text = done.stderr[done.stderr.index(error) :]
    assert [name for name in named if name not in text] == [], text
    assert files_of(folder) == before
