"""Output of the commands with ``--json``, as data: one class per schema, whose attributes are the keys.

``python -m hiltest.documents`` regenerates the JSON Schemas of these classes; docs/json.md lists them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hiltest.campaigns.bisection import FirstWorse
from hiltest.json_schema import DescribedFields
from hiltest.procedures.imu_calibration.contents import ImuCalibration
from hiltest.run_record.comparison import Comparison
from hiltest.run_record.run import Verdict
from hiltest.verdict.detection import Detection

SCHEMAS = Path(__file__).with_name("schemas")


@dataclass(frozen=True, slots=True)
class Failed:
    """Error of any command, which replaces its document; standard error has the same text."""

    error: str
    """Class of the error, as in ``hiltest.errors``."""
    message: str
    """Description of the error, its place, and the next step."""
    exit_code: int
    """Exit code of the command."""


@dataclass(frozen=True, slots=True)
class Seeds:
    """``seeds.json``: a campaign over several seeds."""

    exit_code: int
    """Exit code of the seeds, without a comparison."""
    made_with: list[dict[str, Any]]
    """Firmware, build, cycle model and rig of the runs."""
    seeds: list[dict[str, Any]]
    """Exit code and sentence of each seed."""
    measurements: list[dict[str, Any]]
    """Smallest, median and largest value of each measurement."""
    comparison: Comparison | None = None
    """Comparison with the base, if one was named."""


@dataclass(frozen=True, slots=True)
class Boards:
    """``boards.json``: several boards that ran at once."""

    exit_code: int
    """Exit code that takes precedence among those of the boards."""
    sentence: str
    """Number of boards that pass, and the results of the others."""
    boards: list[dict[str, Any]]
    """Each with ``name``, ``folder``, ``exit_code``, ``sentence`` and ``firmware``."""
    measurements: list[dict[str, Any]]
    """Each with ``name``, ``unit``, ``values`` and ``outcomes`` by board, and their ``spread``."""


@dataclass(frozen=True, slots=True)
class Comparisons:
    """Comparisons of runs with a base."""

    comparisons: list[Comparison]
    """Comparison for each NEW: sentence, obstacles, and the difference of each measurement."""
    detection: Detection | None = None
    """Numbers of runs that detect a change, with ``--detect``."""


@dataclass(frozen=True, slots=True)
class Saved:
    """A baseline that was saved."""

    file: str
    """File that was written."""
    measurements: int
    """Number of measurements in it."""
    build_id: str
    """Build of the measurements."""
    seeds: list[int | None]
    """Seeds of the run; null for a run without a seed."""


@dataclass(frozen=True, slots=True)
class Updated:
    """A baseline that was updated."""

    file: str
    """File that was written."""
    moved: list[dict[str, Any]]
    """Measurements that were accepted: ``name``, ``was`` before, and ``now``."""
    measurements: int
    """Number of measurements in it."""


@dataclass(frozen=True, slots=True)
class Trend:
    """Measurements over the runs of a folder."""

    entries: list[dict[str, Any]]
    """Runs in order of time."""
    lines: list[dict[str, Any]]
    """Conditions that joined runs share."""
    measurements: list[dict[str, Any]]
    """Measurements with values, limits and change points by line."""
    skipped: list[dict[str, Any]]
    """Files that are no records, and the reasons."""


@dataclass(frozen=True, slots=True)
class Reported:
    """Reports that were written again."""

    folder: str
    """Folder of the reports."""
    files: list[str]
    """Names of the reports."""
    verdict: Verdict
    """Verdict of the run."""


@dataclass(frozen=True, slots=True)
class Exported:
    """Numbers for another tool."""

    format: str
    """Requested format."""
    numbers: int
    """Number of exported numbers."""
    file: str | None
    """File that was written; null if none was requested."""
    content: dict[str, Any] | list[Any]
    """Content for the other tool."""


@dataclass(frozen=True, slots=True)
class Timing:
    """A timing profile."""

    name: str
    digest: str
    file: str
    """Name, digest and file of the profile."""
    rows: list[dict[str, Any]]
    """Cycles, range and source of each row."""
    memory: list[dict[str, Any]]
    """Cycles, range and source of the rows of memories."""


@dataclass(frozen=True, slots=True)
class Worst:
    """A search for the most cycles of a function, or a call with a saved input."""

    call: str
    """Short description of function and input."""
    cycles: int | None
    """Cycles of the worst call; null if none succeeded."""
    cycle_model: str
    """Cycle model of the counts."""
    file: str | None
    """File with the saved input."""
    calls: int | None = None
    """Number of calls of the search; null for a call with a saved input."""
    refused_cycles: int | None = None
    """Most cycles of a call that did not succeed."""
    kept_cycles: int | None = None
    """Saved cycles, for a call with a saved input."""
    same_build: bool = True
    """True if the saved cycles belong to this ELF."""


@dataclass(frozen=True, slots=True)
class Measured:
    """A timing profile that was measured."""

    file: str
    """File that was written; ``hiltest timing show --profile FILE --json`` has its rows."""
    name: str
    """Name of the profile."""
    rows: int
    """Number of measured rows."""
    remarks: list[str]
    """Deviations from the rules."""


@dataclass(frozen=True, slots=True)
class ProfileChecked:
    """A measured timing profile, checked before it is sent in."""

    file: str
    name: str
    """Name of the profile."""
    objections: list[str]
    """Reasons why it cannot be accepted unchanged; empty if it can."""
    remarks: list[str]
    """Deviations from the rules."""


@dataclass(frozen=True, slots=True)
class Copied:
    """A bench of one's own."""

    folder: str
    """Folder of suites, rigs, benchmarks and a baseline."""
    rig: str | None
    """Rig that was proposed for the firmware; null without one."""
    next: list[str]
    """Arguments of the next command, to be run in DIR."""


@dataclass(frozen=True, slots=True)
class Understood:
    """Interpretation of firmware that speaks its own language."""

    seconds: float
    """Duration of listening, by the board's clock."""
    understood: int
    not_understood: int
    """Numbers of lines, packets or readings."""
    quantities: dict[str, dict[str, Any]]
    """Number of ``values`` and of values ``per_second`` of each quantity; null if the rate is unknown."""


@dataclass(frozen=True, slots=True)
class Served:
    """The ports of a board, in one line, as soon as they can be opened; the command keeps running."""

    board: str
    turntable: str | None
    """Names of their ports; with ``--replay`` there is no turntable."""
    uarts: dict[str, str]
    """Ports of further UARTs, by name."""
    gdb: str | None
    """Address for GDB; null without ``--gdb``."""
    firmware: str
    rig: str
    cycle_model: str
    """Firmware, rig and cycle model of the served board."""


@dataclass(frozen=True, slots=True)
class Ports:
    """Boards that are plugged in, and the other serial ports."""

    boards: list[dict[str, Any]]
    """``serial_number``, ``usb_id``, ``product``, ``port``, ``volume`` and ``daplink_version``; null if missing or
    unknown."""
    others: list[dict[str, Any]]
    """``port``, ``usb_id``, ``serial_number`` and ``product``, and the ``reason`` why the port is not used."""


@dataclass(frozen=True, slots=True)
class Flashed:
    """Firmware that was flashed."""

    file: str
    """File that was flashed."""
    bytes: int
    """Number of bytes that were written."""
    build_id: str
    """Build of the file; empty if it has none."""
    by: str
    """Method: ``daplink``, by its drive, or ``pyocd``."""
    serial_number: str | None
    port: str | None
    volume: str | None
    """Properties of the board, as far as they are known."""
    answered: str | None
    """Build that the board answered afterwards; null if it was not asked."""
    said: str
    """Description of the firmware that runs now."""


@dataclass(frozen=True, slots=True)
class Examined:
    """Checks of a bench."""

    rig: str
    exit_code: int
    checks: list[dict[str, Any]]
    """Checks with ``name``; ``health``: ``ok``, ``warning``, ``FAILED`` or ``not looked at``; ``found``, the finding
    or the reason why the check was not made; and ``remedy``, null if none is needed."""


@dataclass(frozen=True, slots=True)
class Logged:
    """Samples that were logged."""

    file: str
    """File that was written."""
    samples: dict[str, int]
    """Number of samples by sensor."""
    lost: int
    """Number of gaps in the samples of the gyroscope."""
    ended_early: bool
    """True if Ctrl-C ended the log."""


@dataclass(frozen=True, slots=True)
class ImuFit:
    """A calibration from an IMU log."""

    hiltest: str
    verdict: str
    """Version, and verdict: good, fair, poor or refused."""
    complete: bool
    """True if both sensors were calibrated."""
    files: list[str]
    """Files that were read."""
    samples: int
    """Number of samples."""
    seconds: float
    """Time from the first to the last sample."""
    rests: list[dict[str, Any]]
    """Intervals at rest."""
    accelerometer: dict[str, Any]
    """Gain, offset, and their quality."""
    gyroscope: dict[str, Any] | None
    """Bias, matrix, turns and rates; null without a gyroscope."""
    notes: list[str]
    """Further remarks."""


@dataclass(frozen=True, slots=True)
class Allan:
    """Noise of a gyroscope at rest."""

    hiltest: str
    file: str
    unit: str
    """Version, log, and dps or counts."""
    samples: int
    rows: int
    gaps: int
    """Numbers of used samples, of rows in the file, and of gaps in it."""
    start_s: float | None
    rate_hz: float | None
    jitter_s: float | None
    """First instant, rate, and deviation of the time stamps."""
    notes: list[str]
    """Further remarks."""
    columns: list[dict[str, Any]]
    """Random walk, instability and bias of each column."""
    curve: dict[str, Any]
    """Deviation over time by column, with 95 % limits."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """Packets of NXP's sensor fusion."""

    source: str
    """File or port."""
    packets: int
    lost_bytes: int
    missing: int
    resets: int
    """Numbers of packets, of bytes outside of packets, of missing packets by their numbers, and of clock resets."""
    releases: list[str]
    """Releases that send such packets."""
    firmware: int | None
    """Number of the firmware, 720 for 7.20; null if no packet has it."""
    elapsed_s: float
    """Time by the board's clock."""
    kinds: list[dict[str, Any]]
    """``type``, ``title``, ``packets`` and ``per_second`` of each kind of packet."""


@dataclass(frozen=True, slots=True)
class Played:
    """Results of firmware from a recording."""

    hiltest: str
    playing: str
    """Version, and the recording in words."""
    points: int
    """Number of points of the magnetometer."""
    moments_s: list[float]
    """Times of the headings, relative to the recording's beginning."""
    remarks: list[str]
    """Further remarks."""
    found: list[dict[str, Any]]
    """Results by firmware or calibrator: hard iron, field, errors, cycles and headings."""


@dataclass(frozen=True, slots=True)
class Studied:
    """A study that was run."""

    folder: str
    """Folder of ``run.json`` and ``study.html``."""
    figures: list[dict[str, Any]] = field(default_factory=list)
    """Figures with ``figure``, ``paper``, ``printed`` and ``measured`` value, ``reproduced`` and the reason
    ``because``."""
    verdict: Verdict | None = None
    """Verdict of its record."""


DOCUMENTS: dict[str, type] = {
    "hiltest.error/1": Failed,
    "hiltest.seeds/1": Seeds,
    "hiltest.boards/1": Boards,
    "hiltest.comparison/1": Comparisons,
    "hiltest.baseline-save/1": Saved,
    "hiltest.baseline-update/1": Updated,
    "hiltest.bisection/1": FirstWorse,
    "hiltest.trend/1": Trend,
    "hiltest.report/1": Reported,
    "hiltest.export/1": Exported,
    "hiltest.worst/1": Worst,
    "hiltest.timing/1": Timing,
    "hiltest.timing-measure/1": Measured,
    "hiltest.timing-check/1": ProfileChecked,
    "hiltest.ports/1": Ports,
    "hiltest.doctor/1": Examined,
    "hiltest.init/1": Copied,
    "hiltest.device-try/1": Understood,
    "hiltest.serve/1": Served,
    "hiltest.imu-calibration/1": ImuCalibration,
    "hiltest.flash/1": Flashed,
    "hiltest.log/1": Logged,
    "hiltest.fit-imu/1": ImuFit,
    "hiltest.allan/1": Allan,
    "hiltest.decode/1": Decoded,
    "hiltest.play/1": Played,
    "hiltest.study/1": Studied,
}
"""Class of each schema. The schemas of runs, fits and profiles are in other packages."""


def schema_file(schema: str) -> Path:
    """Return the path of a document's JSON Schema."""
    from hiltest.log_fitting.sample_fit_exports import SCHEMA_FILE as FIT
    from hiltest.run_record.schema import SCHEMA_FILE as RUN
    from hiltest.virtual.profiling.document import SCHEMA_FILE as PROFILE

    elsewhere = {"hiltest.run/1": RUN, "hiltest.fit/1": FIT, "hiltest.profile/1": PROFILE}
    return elsewhere.get(schema) or SCHEMAS / f"{schema.partition('/')[0].removeprefix('hiltest.')}.schema.json"


def schema_text(schema: str) -> str:
    """Return the text of a JSON Schema, generated from the document's class.

    Keys without a default are required. Keys that a later version adds have one, and readers ignore unknown keys.
    """
    from pydantic import TypeAdapter

    document = TypeAdapter(DOCUMENTS[schema]).json_schema(mode="validation", schema_generator=DescribedFields)
    document["properties"] = {"schema": {"const": schema}, **document["properties"]}
    document["required"] = ["schema", *(key for key in document["required"] if key != "schema")]
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", **document, "title": schema}
    return json.dumps(head, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    SCHEMAS.mkdir(exist_ok=True)
    for schema_name in DOCUMENTS:
        schema_file(schema_name).write_text(schema_text(schema_name), encoding="utf-8")
