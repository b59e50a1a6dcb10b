"""Inputs that were made to be expensive are read or refused within the budgets of processor time and memory."""

from __future__ import annotations

import gzip
import json
import resource
import subprocess
import sys
import zlib
from contextlib import suppress
from pathlib import Path

import pytest
import regex
from tests.hostile_elf import (
    array_of_dimensions,
    elf_with,
    files_without_size,
    nested_namespaces,
    nested_structs,
    overlapping_line_programs,
    static_variables,
    units_with_one_line_program,
)
from tests.input_budgets import Meter
from tests.test_fuzzed_inputs import read_debug_information

from hiltest.budgets import DEBUG, HEX, INTERVALS, PATTERN, RECORD, RECORDING, RIG, STREAM, Budget
from hiltest.errors import ConfigError
from hiltest.interfaces.text_lines import Pattern, written_out_size
from hiltest.link import grbl
from hiltest.virtual.program.elf import FirmwareImage
from hiltest.virtual.program.signatures import Element, Pointed

# Reading in a process of its own: its limits are twice the budgets, beside the needs of Python and its imports.
READ = {
    "json": "from hiltest.json_files import read_json; read_json(path, otherwise='')",
    "recording": "from hiltest.tape.recorded_run import read_transcript; read_transcript(path)",
    "firmware": "from hiltest.virtual.program.elf import load_image; load_image(path)",
    "rig": "from hiltest.rig.rig_file import load_rig; load_rig(path)",
    "pattern": "from hiltest.interfaces.text_lines import Pattern; Pattern(path.read_text())",
}
PACKED = b"ZLIB" + (1 << 28).to_bytes(8, "big") + zlib.compress(bytes(1 << 28))
IMPORTS_S, IMPORTS_BYTES = 3.0, 512 << 20


def read_within_budget(kind: str, path: Path, budget: Budget) -> str:
    """Read a file in a process whose limits are twice the budget; return the error that ended it."""
    seconds = round(2 * budget.time_for_s(path.stat().st_size) + IMPORTS_S)
    limits = (
        (resource.RLIMIT_CPU, (seconds, seconds)),
        (resource.RLIMIT_AS, (2 * budget.memory_bytes + IMPORTS_BYTES,) * 2),
    )
    code = f"import sys; from pathlib import Path; path = Path(sys.argv[1]); {READ[kind]}"
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
        preexec_fn=lambda: [resource.setrlimit(*limit) for limit in limits] and None,
        env={"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": ":".join(sys.path)},
    )
    assert done.returncode in (0, 1), f"killed by signal {-done.returncode}"
    return done.stderr.strip().rpartition("\n")[2]


def test_three_megabytes_of_json_with_one_late_duplicate_key_are_refused_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    keys = [f'"key{number:06d}": {number}' for number in range(160_000)]
    path.write_text(f"{{{', '.join([*keys, keys[-1]])}}}")
    assert path.stat().st_size > 3_200_000
    assert read_within_budget("json", path, RECORD).endswith('key "key159999" stands twice in one object;')


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" + "[],{}," * 1_000_000 + "0]", "more than 2000000 values, the budget of a record"),
        ("[" * 1_000_000, "nested more than 32 levels deep, the budget of a record"),
        (f"[{'9' * 5_000_000}]", "is too large for a whole number"),
        (f'["{"," * 2_000_001}"]', "more than 2000000 values, the budget of a record"),
    ],
    ids=["small values", "brackets", "digits", "separators in a text"],
)
def test_json_of_many_or_large_values_is_refused_within_its_budget(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    path.write_text(text)
    assert reason in read_within_budget("json", path, RECORD)


def test_a_small_file_that_unpacks_to_millions_of_entries_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    recordings = Path(__file__).parents[1] / "fixtures" / "recordings"
    header = gzip.decompress((recordings / "by-hand.jsonl.gz").read_bytes()).partition(b"\n")[0]
    path = tmp_path / "bomb.jsonl.gz"
    with gzip.open(path, "wb") as file:
        file.write(header + b"\n")
        for _ in range(240):
            file.write(b'{"t":0,"dir":"@"}\n' * 50_000)
    assert path.stat().st_size < 1_000_000
    text = read_within_budget("recording", path, RECORDING)
    assert text.endswith(f"{path}: more than 6000000 values, the budget of a recording; name a recording (JSON lines)")


def test_one_line_without_an_end_is_refused_by_the_budget_of_a_line(tmp_path: Path) -> None:
    path = tmp_path / "line.jsonl.gz"
    path.write_bytes(gzip.compress(b" " * (64 << 20)))
    text = read_within_budget("recording", path, RECORDING)
    assert text.endswith(
        "larger than 4194304 bytes, the budget of a line of a recording; name a recording (JSON lines)"
    )


def hex_record(kind: int, offset: int, data: bytes) -> str:
    body = bytes((len(data), *offset.to_bytes(2, "big"), kind)) + data
    return f":{(body + bytes((-sum(body) & 0xFF,))).hex()}\n"


def test_intel_hex_in_65536_pieces_is_refused_and_in_4096_is_read(tmp_path: Path) -> None:
    pieces = [
        hex_record(4, 0, page.to_bytes(2, "big")) + "".join(hex_record(0, at, b"\x01") for at in range(0, 65_536, 16))
        for page in range(16)
    ]
    path = tmp_path / "pieces.hex"
    path.write_text("".join([*pieces, hex_record(1, 0, b"")]))
    text = read_within_budget("firmware", path, HEX)
    assert "more than 4096 separate pieces, the budget of Intel HEX; name the program of one chip" in text
    path.write_text("".join([pieces[0], hex_record(1, 0, b"")]))
    assert read_within_budget("firmware", path, HEX) == ""


@pytest.mark.parametrize(
    "pattern", ["a{1000000000}", "(?:(?:a{1000}){1000}){1000}", r"[\]{1}]{0,99999}", "(a{100}b{100}){100}"]
)
def test_a_pattern_that_is_large_once_it_is_compiled_is_refused(pattern: str, tmp_path: Path) -> None:
    path = tmp_path / "pattern"
    path.write_text(pattern)
    text = read_within_budget("pattern", path, PATTERN)
    assert "more than 10000 characters with its repetitions written out, the budget of a pattern" in text


@pytest.mark.parametrize(
    ("pattern", "size"),
    [(r"\d{3}", 6), (r"[{2}]{3}", 15), (r"a\{9}", 5), ("x{,7}", 7), ("x{2,}", 2), ("()", 1)],
)
def test_the_size_of_a_pattern_counts_each_character_as_often_as_it_is_repeated(pattern: str, size: int) -> None:
    regex.compile(pattern)
    assert written_out_size(pattern) == size


def test_patterns_of_ordinary_length_are_taken() -> None:
    assert Pattern(r"H=(?P<heading>\d{1,3}(?:\.\d{1,6})?),.{0,80}\*(?P<sum>[0-9A-F]{2})").groups == {"heading", "sum"}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            f"{'.'.join('a' * 200_000)} = 1\n",
            "nested more than 16 levels deep, the budget of a rig; write",
        ),
        (f"[{'.'.join('a' * 200_000)}]\n", "nested more than 16 levels deep, the budget of a rig"),
        (
            "".join(f"[[a{n}]]\n" for n in range(40_000)) + "".join(f"[b{n}]\n" for n in range(40_000)),
            "schema is missing",
        ),
        (f"a = [\n[{' ' * 900_000}\n1]]\n", "schema is missing"),
        ("a = [" + "0," * 250_000 + "]\n", "more than 200000 values, the budget of a rig"),
        ("[" * 500_000, "more than 200000 values, the budget of a rig"),
    ],
    ids=["a long key", "a long table", "many tables", "blanks", "numbers", "brackets"],
)
def test_a_rig_that_is_expensive_to_parse_is_refused_within_its_budget(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(text)
    assert reason in read_within_budget("rig", path, RIG)


@pytest.mark.parametrize(
    "content",
    [
        elf_with(nested_structs(22)),
        elf_with(nested_namespaces(300, 3000)),
        elf_with(array_of_dimensions(4000)),
        elf_with(static_variables(2000)),
        elf_with(*units_with_one_line_program(500, 10_000)),
        elf_with(*overlapping_line_programs(300, 10_000)),
        elf_with(*files_without_size(1_000_000)),
        elf_with(*files_without_size(1_000_000, form=0x19)),
        elf_with(
            static_variables(1), zdebug_info=b"ZLIB" + (1 << 32).to_bytes(8, "big") + zlib.compress(bytes(1 << 28))
        ),
    ],
    ids=[
        "structs",
        "namespaces",
        "dimensions",
        "statics",
        "one line program",
        "overlapping line programs",
        "files of no format",
        "files of a form without bytes",
        "packed",
    ],
)
def test_small_debug_information_that_grows_as_it_is_read_stays_within_its_budget(content: bytes) -> None:
    meter, size = Meter(), len(content)
    with suppress(ConfigError):  # without lines there is no coverage
        meter.read(lambda: read_debug_information(content), DEBUG, size)


def test_a_status_of_the_turntable_with_many_digits_is_read_within_the_budget_of_a_port() -> None:
    text = f"<Idle|MPos:{'9' * 32_000}"
    assert Meter().read(lambda: grbl._status(text), STREAM, len(text)) is None


def test_structs_in_structs_have_the_numbers_of_the_innermost() -> None:
    signature = FirmwareImage(elf_with(nested_structs(22))).signature("f")
    assert signature is not None
    assert signature.pointed == (Pointed("struct s21 *", frozenset({Element(True, 4)})),)


def test_a_refusal_of_a_file_names_budget_file_and_next_step(tmp_path: Path) -> None:
    path = tmp_path / "intervals.json"
    path.write_text(json.dumps(list(range(200_000))))
    code = (
        "import sys; from pathlib import Path; from hiltest.budgets import INTERVALS; from hiltest.json_files import "
        "read_json; read_json(Path(sys.argv[1]), budget=INTERVALS, otherwise='name another')"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1].endswith(
        f"{path}: larger than {INTERVALS.bytes} bytes, the budget of {INTERVALS.name}; name another"
    )
