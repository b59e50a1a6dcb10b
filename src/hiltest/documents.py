"""What the commands print with ``--json``, as data: one class a schema, its attributes the keys.

``python -m hiltest.documents`` writes the JSON Schemas of these classes anew; docs/json.md lists them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hiltest.imu_calibration.contents import ImuCalibration
from hiltest.json_schema import DescribedFields
from hiltest.record.comparison import Comparison
from hiltest.record.run import Verdict
from hiltest.runs.bisection import FirstWorse
from hiltest.verdict.detection import Detection

SCHEMAS = Path(__file__).with_name("schemas")


@dataclass(frozen=True, slots=True)
class Failed:
    """Error of any command, in the place of its document; standard error says the same."""

    error: str
    """Class of the error, as in ``hiltest.errors``."""
    message: str
    """What is wrong, where, and the next step."""
    exit_code: int
    """That of the command."""


@dataclass(frozen=True, slots=True)
class Seeds:
    """``seeds.json``: a campaign over several seeds."""

    exit_code: int
    """Of the seeds, apart from a comparison."""
    made_with: list[dict[str, Any]]
    """Firmware, build, cycle model and rig of the runs."""
    seeds: list[dict[str, Any]]
    """Exit code and sentence of each seed."""
    measurements: list[dict[str, Any]]
    """Smallest, middle and largest of each measurement."""
    comparison: Comparison | None = None
    """With the base, where one was named."""


@dataclass(frozen=True, slots=True)
class Boards:
    """``boards.json``: several boards that ran at once."""

    exit_code: int
    """Of all boards' codes the first that applies."""
    sentence: str
    """How many pass, and how the others ended."""
    boards: list[dict[str, Any]]
    """Each with ``name``, ``folder``, ``exit_code``, ``sentence`` and ``firmware``."""
    measurements: list[dict[str, Any]]
    """Each with ``name``, ``unit``, ``values`` and ``outcomes`` by board, and their ``spread``."""


@dataclass(frozen=True, slots=True)
class Comparisons:
    """Comparisons of runs with a base."""

    comparisons: list[Comparison]
    """One for each NEW: sentence, obstacles, and the difference of each measurement."""
    detection: Detection | None = None
    """With ``--detect``: how many runs see a change."""


@dataclass(frozen=True, slots=True)
class Saved:
    """A baseline that was saved."""

    file: str
    """That was written."""
    measurements: int
    """How many it has."""
    build_id: str
    """Build that they are of."""
    seeds: list[int | None]
    """Their seeds; null for a run of no seed."""


@dataclass(frozen=True, slots=True)
class Updated:
    """A baseline that was updated."""

    file: str
    """That was written."""
    moved: list[dict[str, Any]]
    """Measurements that were accepted: ``name``, and what it ``was`` and is ``now``."""
    measurements: int
    """How many are in it."""


@dataclass(frozen=True, slots=True)
class Trend:
    """Measurements over the runs of a folder."""

    entries: list[dict[str, Any]]
    """The runs, in the order of time."""
    lines: list[dict[str, Any]]
    """Conditions that joined runs share."""
    measurements: list[dict[str, Any]]
    """Each with its values, limits and change points by line."""
    skipped: list[dict[str, Any]]
    """Files that are no records, and why."""


@dataclass(frozen=True, slots=True)
class Reported:
    """Reports that were written again."""

    folder: str
    """Where they are."""
    files: list[str]
    """Their names."""
    verdict: Verdict
    """Of the run."""


@dataclass(frozen=True, slots=True)
class Exported:
    """Numbers for another tool."""

    format: str
    """As asked for."""
    numbers: int
    """How many."""
    file: str | None
    """That was written; null where none was asked for."""
    content: dict[str, Any] | list[Any]
    """What the other tool reads."""


@dataclass(frozen=True, slots=True)
class Timing:
    """A timing profile."""

    name: str
    digest: str
    file: str
    """Of the profile."""
    rows: list[dict[str, Any]]
    """Cycles, range and source of each row."""
    memory: list[dict[str, Any]]
    """The same of memories."""


@dataclass(frozen=True, slots=True)
class Worst:
    """A search for the most cycles of a function, or a call of what was kept."""

    call: str
    """Function and input, in a few words."""
    cycles: int | None
    """Of the worst call; null where none succeeded."""
    cycle_model: str
    """That counted them."""
    file: str | None
    """Where the input is kept."""
    calls: int | None = None
    """Of the search; null for a call of what was kept."""
    refused_cycles: int | None = None
    """The most of a call that did not succeed."""
    kept_cycles: int | None = None
    """Of a call of what was kept: the cycles that were kept."""
    same_build: bool = True
    """Whether they were kept of this ELF."""


@dataclass(frozen=True, slots=True)
class Measured:
    """A timing profile that was measured."""

    file: str
    """That was written; ``hiltest timing show --profile FILE --json`` has its rows."""
    name: str
    """Of the profile."""
    rows: int
    """How many were measured."""
    remarks: list[str]
    """What does not fit the rules."""


@dataclass(frozen=True, slots=True)
class ProfileChecked:
    """A measured timing profile, checked before it is sent in."""

    file: str
    name: str
    """Of the profile."""
    objections: list[str]
    """Why it cannot be taken as it is; empty where it can."""
    remarks: list[str]
    """What does not fit the rules."""


@dataclass(frozen=True, slots=True)
class Copied:
    """A bench of one's own."""

    folder: str
    """Where suites, rigs, benchmarks and a baseline are now."""
    rig: str | None
    """Rig that was proposed for the firmware; null without one."""
    next: list[str]
    """Arguments of the command to give next, in DIR."""


@dataclass(frozen=True, slots=True)
class Understood:
    """What was understood of firmware in its own words."""

    seconds: float
    """How long it was listened to, by the board's clock."""
    understood: int
    not_understood: int
    """Lines, packets or readings."""
    quantities: dict[str, dict[str, Any]]
    """Of each quantity that was said, how many ``values`` and how many ``per_second``, null where that is unknown."""


@dataclass(frozen=True, slots=True)
class Served:
    """The ports of a board, in one line, as soon as they can be opened; the command goes on."""

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
    """What is served."""


@dataclass(frozen=True, slots=True)
class Ports:
    """Boards that are plugged in, and the other serial ports."""

    boards: list[dict[str, Any]]
    """``serial_number``, ``usb_id``, ``product``, ``port``, ``volume`` and ``daplink_version``; null is what there
    is not, or is not known."""
    others: list[dict[str, Any]]
    """``port``, ``usb_id``, ``serial_number`` and ``product``, and the ``reason`` why it is not taken."""


@dataclass(frozen=True, slots=True)
class Flashed:
    """Firmware that was put onto a board."""

    file: str
    """That was flashed."""
    bytes: int
    """How many were written."""
    build_id: str
    """Of the file; empty where it has none."""
    by: str
    """``daplink``, by its drive, or ``pyocd``."""
    serial_number: str | None
    port: str | None
    volume: str | None
    """Of the board, as far as they are known."""
    answered: str | None
    """Build that the board answered afterwards; null where nothing was asked."""
    said: str
    """What is known of who runs on it now."""


@dataclass(frozen=True, slots=True)
class Examined:
    """What was looked at on a bench."""

    rig: str
    exit_code: int
    checks: list[dict[str, Any]]
    """``name``; ``health``, which is ``ok``, ``warning``, ``FAILED`` or ``not looked at``; what was ``found``, of
    what was not looked at the reason; and the ``remedy``, null where none is needed."""


@dataclass(frozen=True, slots=True)
class Logged:
    """Samples that were logged."""

    file: str
    """That was written."""
    samples: dict[str, int]
    """How many of each sensor."""
    lost: int
    """How often samples of the gyroscope are missing."""
    ended_early: bool
    """Whether Ctrl-C ended it."""


@dataclass(frozen=True, slots=True)
class ImuFit:
    """A calibration from an IMU log."""

    hiltest: str
    verdict: str
    """Version, and good, fair, poor or refused."""
    complete: bool
    """Whether both sensors were calibrated."""
    files: list[str]
    """That were read."""
    samples: int
    """How many."""
    seconds: float
    """From the first to the last."""
    rests: list[dict[str, Any]]
    """Intervals at rest."""
    accelerometer: dict[str, Any]
    """Gain, offset, and how good they are."""
    gyroscope: dict[str, Any] | None
    """Bias, matrix, turns and rates; null without a gyroscope."""
    notes: list[str]
    """What else is to be known."""


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
    """Samples taken, rows of the file, and gaps in it."""
    start_s: float | None
    rate_hz: float | None
    jitter_s: float | None
    """First instant, rate, and how far time stamps stray."""
    notes: list[str]
    """What else is to be known."""
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
    """Packets, bytes in none, packets missing by their numbers, and resets of the board's clock."""
    releases: list[str]
    """Releases that send such packets."""
    firmware: int | None
    """Number of the firmware, 720 for 7.20; null where no packet says it."""
    elapsed_s: float
    """By the board's clock."""
    kinds: list[dict[str, Any]]
    """``type``, ``title``, ``packets`` and ``per_second`` of each kind that came."""


@dataclass(frozen=True, slots=True)
class Played:
    """What firmware found in a recording."""

    hiltest: str
    playing: str
    """Version, and the recording in words."""
    points: int
    """Of the magnetometer."""
    moments_s: list[float]
    """When the headings were, from the recording's beginning on."""
    remarks: list[str]
    """What else is to be known."""
    found: list[dict[str, Any]]
    """By firmware or calibrator: hard iron, field, errors, cycles and headings."""


@dataclass(frozen=True, slots=True)
class Studied:
    """A study that was run."""

    folder: str
    """Of ``run.json`` and ``study.html``."""
    figures: list[dict[str, Any]] = field(default_factory=list)
    """``figure``, ``paper``, what is ``printed`` and was ``measured``, whether it was ``reproduced``, and
    ``because``."""
    verdict: Verdict | None = None
    """Of its record."""


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
"""Class of each schema. The record of a run, a fit and a profile have schemas in packages of their own."""


def schema_file(schema: str) -> Path:
    """Return where the JSON Schema of a document is."""
    from hiltest.logs.sample_fit_exports import SCHEMA_FILE as FIT
    from hiltest.profiling.document import SCHEMA_FILE as PROFILE
    from hiltest.record.schema import SCHEMA_FILE as RUN

    elsewhere = {"hiltest.run/1": RUN, "hiltest.fit/1": FIT, "hiltest.profile/1": PROFILE}
    return elsewhere.get(schema) or SCHEMAS / f"{schema.partition('/')[0].removeprefix('hiltest.')}.schema.json"


def schema_text(schema: str) -> str:
    """Return the text of a JSON Schema, generated from the document's class.

    Required is what has no default. Keys that a later version adds have one: a reader ignores those that it does not
    know.
    """
    from pydantic import TypeAdapter

    made = TypeAdapter(DOCUMENTS[schema]).json_schema(mode="validation", schema_generator=DescribedFields)
    made["properties"] = {"schema": {"const": schema}, **made["properties"]}
    made["required"] = ["schema", *(each for each in made["required"] if each != "schema")]
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", **made, "title": schema}
    return json.dumps(head, indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    SCHEMAS.mkdir(exist_ok=True)
    for each in DOCUMENTS:
        schema_file(each).write_text(schema_text(each), encoding="utf-8")
