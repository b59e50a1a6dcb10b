"""Fuzzed inputs of every decoder and reader: each is read, or refused by an error that its docstring names.

Inputs are seeded: valid ones, cut, flipped, doubled, spliced and sprinkled with what readers stumble over; some of them
with one part repeated, counted up or nested, up to 1 MiB. None takes more than twice its budget of processor time or
memory (hiltest.budgets). How many there are is in HILTEST_FUZZED: 20 000, and 1 000 000 in tox's reliability.
"""

from __future__ import annotations

import argparse
import gzip
import os
import random
import tomllib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from tests.hostile_elf import elf_with, nested_structs, overlapping_line_programs, static_variables
from tests.imu_calibration.conftest import some_calibration
from tests.input_budgets import Meter, input_of
from tests.interfaces.test_packet_stream import RECORDING as PACKETS
from tests.interfaces.test_packet_stream import WIRES
from tests.interfaces.test_text import SAMPLES, opened
from tests.link.test_trace_text import REQUESTS
from tests.log_fitting.recording import six_faces_and_turns, write
from tests.totals import session_totals

from hiltest.boards import ReplayBoard, default_firmware
from hiltest.boards.gcode import GcodeError, Modals, read_block
from hiltest.boards.served_recording import ServedRecording
from hiltest.budgets import (
    ARGUMENT,
    CALIBRATION,
    DEBUG,
    ELF,
    INTERVALS,
    PART,
    PROFILE,
    RECORD,
    RECORDING,
    RIG,
    STREAM,
    TABLE,
    Budget,
)
from hiltest.errors import CalibrationError, ConfigError, DeviceError, FrameError, HiltestError, ProtocolError
from hiltest.interfaces.candidate_variables import variable_candidates
from hiltest.interfaces.packet_csv import PacketRows
from hiltest.interfaces.packet_stream import batches
from hiltest.interfaces.packet_summary import summary_of
from hiltest.interfaces.packets import KINDS
from hiltest.interfaces.proposed_rig import chosen_kind, look_at, rig_text
from hiltest.interfaces.sensor_files.recorded_motion import read_playback
from hiltest.interfaces.trial import Trial
from hiltest.json_files import parse_json
from hiltest.link import grbl
from hiltest.link.framing import DamagedFrame, Frame, FrameDecoder, encode_frame, stuff, unstuff
from hiltest.link.request import decode_reply
from hiltest.link.request_reading import read_request
from hiltest.link.trace_text import trace_lines
from hiltest.link.transcript import Direction, Transcript
from hiltest.log_fitting.imu_log import read_imu_log
from hiltest.log_fitting.intervals import listed_intervals
from hiltest.log_fitting.rate_log import read_rate_log
from hiltest.log_fitting.samples import read_samples
from hiltest.procedures.imu_calibration.calibration_file import load_calibration, to_json
from hiltest.rig.bench_files import shipped
from hiltest.rig.recorded_motion import PlaybackFile
from hiltest.rig.rig_file import load_rig, parse_rig
from hiltest.run_record.reader import read_record
from hiltest.session.settings import file_name, label, seed
from hiltest.tape.player import Player
from hiltest.tape.recorded_run import read_transcript
from hiltest.verdict.evidence_reader import read_evidence
from hiltest.virtual.coverage.source_map import SourceMap
from hiltest.virtual.model.profile_file import load_profile, shipped_profiles
from hiltest.virtual.part.part_file import load_part, shipped_parts
from hiltest.virtual.profiling.arguments import parse_argument
from hiltest.virtual.program.elf import FirmwareImage

# One in so many inputs is large, and the first of each reader: the large ones take as long as all others.
LARGE_SHARE = 1 / 1000
FEWEST_LARGE = 5
INPUTS = int(os.environ.get("HILTEST_FUZZED", "20000"))
BASELINES = Path(__file__).parents[1] / "hil" / "baselines"
# What readers stumble over: ends, quotes, numbers that are none, words that mean something.
TOKENS = (
    *(bytes([item]) for item in b"\x7e\x7d\x00\xff\n\r\t,;\"'[]{}=:.-e0\\#GX$|<>"),
    b"\x7d\x5e",
    b"nan",
    b"-inf",
    b"1e999",
    b"-1",
    b"99999999999999999999",
    b"null",
    b"true",
    b"\xef\xbb\xbf",
    b"\xff\xfe",
    b"\xf0\x9f\x99\x82",
    b"\\u0000",
    b"//",
    b"Raw:",
    b" -> ",
    b"[[",
    b"[world]",
    b"schema",
    b"G0",
)


def mutated(dice: random.Random, content: bytes, others: Sequence[bytes]) -> bytes:
    """Return a valid input with a few things done to it."""
    data = bytearray(content)
    for _ in range(dice.choice((0, 1, 1, 2, 4, 16))):
        at = dice.randrange(len(data) + 1)
        kind = dice.randrange(8)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << dice.randrange(8)
        elif kind == 1 and data:
            data[at % len(data)] = dice.randrange(256)
        elif kind == 2:
            del data[at : at + dice.choice((1, 2, 7, 100))]
        elif kind == 3:
            data[at:at] = dice.choice(TOKENS)
        elif kind == 4:
            data[at:at] = data[at : at + dice.choice((1, 4, 40))]
        elif kind == 5:
            del data[at:]
        elif kind == 6:
            other = dice.choice(others)
            where = dice.randrange(len(other) + 1)
            data[at:] = other[where : where + 4000]
        else:
            data[at:at] = dice.randbytes(dice.choice((1, 4, 20)))
    return bytes(data)


@dataclass(frozen=True)
class Reader:
    """A reader under test.

    Attributes
    ----------
    read : callable
        Takes the bytes, or the file that they stand in.
    refuses : tuple of type
        What its docstring says it may raise.
    corpus : sequence of bytes
        Valid inputs.
    share : float
        Share of all inputs.
    suffix : str
        Of the file; without one it reads bytes.
    budget : Budget
        What one input may cost.
    """

    read: Callable[..., object]
    refuses: tuple[type[Exception], ...]
    corpus: Sequence[bytes]
    share: float
    suffix: str | None = None
    budget: Budget = STREAM

    def take(self, content: bytes, folder: Path) -> object:
        """Read an input, in a folder for the file that it may have to stand in."""
        if self.suffix is None:
            return self.read(content)
        (folder / f"fuzzed{self.suffix}").write_bytes(content)
        return self.read(folder / f"fuzzed{self.suffix}")


def _frames(data: bytes) -> None:
    """Decode a stream at once and in pieces, which is the same; an intact frame is one that can be sent."""
    decoder, pieces = FrameDecoder(), FrameDecoder()
    feed, step = decoder.feed(data), 1 + len(data) // 512
    assert feed == [item for at in range(0, len(data), step) for item in pieces.feed(data[at : at + step])]
    for packet in feed:
        assert isinstance(packet, Frame | DamagedFrame)
        if isinstance(packet, Frame):
            assert FrameDecoder().feed(encode_frame(packet)) == [packet]


def _unstuffed(data: bytes) -> None:
    assert unstuff(stuff(data)) == data
    unstuff(data)


def _reply(data: bytes) -> object:
    return decode_reply(REQUESTS[(data[0] if data else 0) % len(REQUESTS)], data[1:])


def _request(data: bytes) -> object:
    return read_request(Frame(data[0] & 0x7F if data else 0, 1, data[1:]))


def _packets(data: bytes) -> None:
    summary, release = summary_of(data)
    rows = PacketRows(KINDS)
    for batch in batches(data, release):
        assert rows.lines(batch).count("\n") == len(batch.packets())
    assert sum(summary.counts.values()) <= data.count(b"\x7e")


def _text(data: bytes) -> None:
    """Read lines in every form, and as a trial shows them."""
    for table, _ in SAMPLES.values():
        interface = opened(table)
        for observation in interface.feed(b"\n.\n" + data + b"\n", 0.0):
            assert observation.error or observation.values.keys() <= interface.offers
        for heard in Trial({"text": interface}).take(data + b"\n", 1.0):
            assert not {"\n", "\r", "\0", "\x1b"} & set(heard.line)


def _recording(name: str) -> bytes:
    """Return a recording up to its first test."""
    recording = Path(__file__).parents[1] / "fixtures" / "recordings" / f"{name}.jsonl.gz"
    return gzip.decompress(recording.read_bytes()).partition(b'"mark"')[0].rpartition(b"\n")[0]


def _replayed(path: Path) -> None:
    """Open the recorded board, and serve its line."""
    run, transcript = read_transcript(path)
    served = ServedRecording(transcript, path)
    for number, entry in enumerate(transcript.entries):
        if entry.direction is Direction.TO_BOARD:
            served.hear(entry.data, float(number))
        served.say(1e9 + number)
    tape = Player(transcript, path)
    rig = parse_rig(Path(run.rig_file), run.rig_text.encode("utf-8", errors="replace"))
    ReplayBoard(tape, rig).close()


def _trace(data: bytes) -> None:
    transcript = Transcript("virtual")
    for number, piece in enumerate(data.split(b"\x55")):
        transcript.add(0.1 * number, (Direction.TO_BOARD, Direction.TO_HOST, Direction.MARK)[number % 3], piece)
    assert all(isinstance(line, str) for line in trace_lines(transcript))


def _gcode(data: bytes) -> None:
    block = read_block(data.decode("ascii", errors="replace").upper(), Modals())
    assert set(block.axes) <= set("XYZ")


def _samples(path: Path) -> None:
    assert np.isfinite(read_samples(path).points).all()


def _words(data: bytes) -> None:
    text = data.decode("utf-8", errors="surrogateescape")
    for parse in (seed, label, file_name):
        try:
            parse(text)
        except argparse.ArgumentTypeError:
            continue


def _wires() -> list[bytes]:
    return [
        encode_frame(Frame(request.code, number % 256, request.payload())) for number, request in enumerate(REQUESTS)
    ]


def _proposed(path: Path) -> None:
    """Look at what may be an ELF; whatever names it has, what is written of it is TOML."""
    proposals = look_at(FirmwareImage(path))
    kind = chosen_kind(proposals, None)
    base = (shipped() / "rigs" / f"{proposals.base_rig}.toml").read_text(encoding="utf-8")
    tomllib.loads(rig_text(proposals, kind, base, name="mine", firmware=str(path), choose=None))


def read_debug_information(content: bytes) -> None:
    """Read all debug information: signatures, variables, and the lines of the code."""
    image = FirmwareImage(content)
    for function in ("f", "main", *image.symbols):
        image.signature(function)
    assert all(candidate.written for candidate in variable_candidates(image)[0])
    SourceMap(image)


@pytest.fixture(scope="session")
def readers(tmp_path_factory: pytest.TempPathFactory, default_run) -> dict[str, Reader]:
    return every_reader(tmp_path_factory.mktemp("corpus"), (default_run.folder / "run.json").read_bytes())


def every_reader(folder: Path, run: bytes) -> dict[str, Reader]:
    """Return every decoder and reader, by name; files of the corpus stand in a folder, `run` is a run.json."""
    write(folder / "imu.csv", *six_faces_and_turns().readings())
    imu = (folder / "imu.csv").read_bytes()[:40_000].rpartition(b"\n")[0]
    log = read_imu_log(folder / "imu.csv")
    points = b"mx_uT,my_uT,mz_uT\n" + b"".join(b"%d,%d.5,-%d\n" % (n, 2 * n, n) for n in range(30))
    points_at = b"t_s,mx_uT,my_uT,mz_uT,ax_g,ay_g,az_g\n" + b"".join(
        b"%d.5,%d,%d.5,-%d,0,0.1,1\n" % (n, n, 2 * n, n) for n in range(30)
    )
    raw = b"boot 1\n" + b"".join(
        b"12:00:%02d.125 -> Raw:%d,-4096,8192,16,-8,%d,480,-%d,3\nUni:0,0,9.8\n" % (n, n, n, n) for n in range(30)
    )
    objects = b"".join(
        b'{"t": %.1f, "mag": [%d, 2.5, -3], "acc": {"x": 0, "y": 1, "z": 0}}\n' % (n / 10, n) for n in range(30)
    )
    numbered = b"Logger: 7\n;0;1;2\n" + b"".join(b"%d;%d,5;-2,25;3;\n" % (n, n) for n in range(30)) + b"30;1"
    wide = ("\ufeff" + points.decode()).encode("utf-16-le")
    forms = [raw, objects, numbered, wide]
    rates = b"time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n" + b"".join(
        b"%.2f,0.%d,-%d,1e-3\n" % (n / 100, n % 9, n % 2) for n in range(300)
    )
    compass = default_firmware().with_name("compass-lines.elf")
    rigs = [path.read_bytes() for path in sorted((shipped() / "rigs").glob("*.toml"))]
    parts = [shipped_part.read_bytes() for shipped_part in shipped_parts().values()]
    profiles = [shipped_profile.read_bytes() for shipped_profile in shipped_profiles().values()]
    replies = [bytes([number]) + bytes(size) for number in range(len(REQUESTS)) for size in (1, 2, 5, 17, 49, 62, 100)]
    requests = [bytes([request.code]) + request.payload() for request in REQUESTS]
    wires = _wires()
    transcript = Transcript("virtual")
    for wire in wires:
        transcript.add(1.5, Direction.TO_BOARD, wire)
    transcript.write(folder / "wire.jsonl")
    intervals = b'{"x_p": {"start": 5, "end": 12}, "x_rot": {"start": 20, "end": 31}}'
    debugged = [
        compass.read_bytes(),
        elf_with(nested_structs(20)),
        elf_with(static_variables(50)),
        elf_with(*overlapping_line_programs(1, 100)),
    ]
    config, data = (ConfigError,), (ConfigError, CalibrationError)
    return {
        "frames": Reader(_frames, (), wires, 0.05),
        "packets": Reader(_packets, (), [*WIRES, PACKETS], 0.03),
        "lines of text": Reader(_text, (), ["\r\n".join(lines).encode() for _, lines in SAMPLES.values()], 0.01),
        "stuffing": Reader(_unstuffed, (FrameError,), wires, 0.10),
        "replies": Reader(_reply, (ProtocolError, DeviceError), replies, 0.30),
        "requests": Reader(_request, (ProtocolError,), requests, 0.15),
        "traces": Reader(_trace, (), [b"\x55".join(wires[n : n + 5]) for n in range(0, 25, 5)], 0.03),
        "G-code": Reader(_gcode, (GcodeError,), [b"G0 X45 Y-10", b"G1F60X1", b"G91G0Z-1.5", b"N4 G4 P0.5"], 0.09),
        "Grbl status": Reader(
            lambda item: grbl._status(item.decode("ascii", errors="replace")),
            (),
            [b"<Idle|MPos:1.000,-2.5,0|FS:0,0>", b"<Hold:1|MPos:1,2,3,4|F:0>"],
            0.10,
        ),
        "options": Reader(_words, (), [b"4294967295", b"v1.2", b"hil-out/run.json"], 0.05),
        "arguments": Reader(
            lambda item: parse_argument(item.decode("utf-8", errors="replace")),
            config,
            [b"float32:1,2.5,-3+ptr:int8:1", b"zeros:int16:40", b"text:123", b"0x1F", b"1e-3"],
            0.06,
            budget=ARGUMENT,
        ),
        "JSON": Reader(
            parse_json, (ValueError,), [b'{"a": [1, 2.5e3, null, {"b": "c"}]}', intervals], 0.02, budget=RECORD
        ),
        "samples": Reader(_samples, data, [points, *forms], 0.01, ".csv", budget=TABLE),
        "rate logs": Reader(read_rate_log, data, [rates, *forms], 0.005, ".csv", budget=TABLE),
        "IMU logs": Reader(read_imu_log, data, [imu, *forms], 0.002, ".csv", budget=TABLE),
        "intervals": Reader(
            lambda path: listed_intervals(log, path), config, [intervals], 0.002, ".json", budget=INTERVALS
        ),
        "recorded runs": Reader(
            _replayed,
            (HiltestError,),
            [_recording("by-hand"), _recording("text-skipped")],
            0.001,
            ".jsonl",
            budget=RECORDING,
        ),
        "transcripts": Reader(
            Transcript.read, config, [(folder / "wire.jsonl").read_bytes()], 0.002, ".jsonl", budget=RECORDING
        ),
        "timing profiles": Reader(
            lambda path: load_profile(str(path)), config, profiles, 0.002, ".toml", budget=PROFILE
        ),
        "part files": Reader(lambda path: load_part(str(path)).timing(), config, parts, 0.002, ".toml", budget=PART),
        "rigs": Reader(load_rig, config, rigs, 0.004, ".toml", budget=RIG),
        "baselines": Reader(
            read_evidence,
            config,
            [path.read_bytes() for path in BASELINES.glob("*.json")] + [run],
            0.0005,
            ".json",
            budget=RECORD,
        ),
        "records": Reader(read_record, config, [run], 0.0005, ".json", budget=RECORD),
        "calibration files": Reader(
            load_calibration, config, [to_json(some_calibration()).encode()], 0.002, ".json", budget=CALIBRATION
        ),
        "recordings": Reader(
            lambda path: read_playback(path, PlaybackFile(path.name)),
            config,
            [points_at, rates, PACKETS, *forms],
            0.005,
            ".csv",
            budget=TABLE,
        ),
        "rigs of ELF files": Reader(_proposed, config, [compass.read_bytes()], 0.0005, budget=DEBUG),
        "debug information": Reader(
            read_debug_information, config, [compass.read_bytes(), *debugged], 0.0005, budget=DEBUG
        ),
        "ELF files": Reader(FirmwareImage, config, [default_firmware().read_bytes()], 0.0005, budget=ELF),
    }


@pytest.fixture
def totals(pytestconfig: pytest.Config) -> Counter[str]:
    """Totals of all readers, printed at the end."""
    return session_totals(pytestconfig, "fuzzed inputs")


NAMES = (
    "ELF files",
    "G-code",
    "Grbl status",
    "IMU logs",
    "JSON",
    "arguments",
    "baselines",
    "calibration files",
    "debug information",
    "frames",
    "intervals",
    "lines of text",
    "options",
    "packets",
    "rate logs",
    "recorded runs",
    "recordings",
    "records",
    "replies",
    "requests",
    "rigs",
    "rigs of ELF files",
    "samples",
    "stuffing",
    "timing profiles",
    "part files",
    "traces",
    "transcripts",
)


def test_every_reader_has_its_share(readers: dict[str, Reader]) -> None:
    assert sorted(readers) == sorted(NAMES)
    assert sum(reader.share for reader in readers.values()) >= 1.0


@pytest.mark.parametrize("name", NAMES)
def test_every_input_is_read_or_refused_as_documented(
    readers: dict[str, Reader], totals: Counter[str], tmp_path: Path, name: str
) -> None:
    reader, meter = readers[name], Meter()
    for number in range(max(20, round(INPUTS * reader.share))):
        dice = random.Random(f"{name} {number}")
        totals["inputs"] += 1
        data = input_of(dice, reader, mutated, LARGE_SHARE if number >= FEWEST_LARGE else 1.0)
        try:
            meter.read(lambda data=data: reader.take(data, tmp_path), reader.budget, len(data))  # type: ignore[misc]
            totals[f"{name} read"] += 1
        except reader.refuses:
            totals[f"{name} refused"] += 1
        except BaseException as error:
            error.add_note(f"{name} {number}: {data[:200]!r}")
            raise
    totals[f"{name} % of the budget of time"] = round(100 * meter.time_share)
    totals[f"{name} % of the budget of memory"] = round(100 * meter.memory_share)
    assert totals[f"{name} read"], "the corpus is none: nothing was read"
