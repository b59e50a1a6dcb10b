"""Judge calibrators and filters, and write docs/leaderboard.md: ``python docs/leaderboard.py [--recordings FOLDER]``.

Results are kept in leaderboard/results.json. Only entries whose digest has changed are judged again, so the command can
be interrupted. ``--page`` writes the page from the results.
"""

from __future__ import annotations

import argparse
import ast
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from itertools import count
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import numpy as np
from scipy.stats import t as student

import hiltest.calibration
from hiltest.boards.bench import default_firmware
from hiltest.calibration import REFERENCES
from hiltest.calibration.fit import Calibrator
from hiltest.calibration.quality import COUNTS_PER_UT
from hiltest.commands.options import ErrorOutput
from hiltest.json_files import json_text, read_as
from hiltest.judge.answers import Answer, Entry
from hiltest.judge.entries import open_entry, open_filter
from hiltest.judge.filter_scores import MOTION, FilterResult, judge_filter
from hiltest.judge.filters import FilterAnswers, JudgedFilter, OwnFilter, readings_of, stride_of
from hiltest.judge.judgement import ALL, EntryResult, compiler_in, judge
from hiltest.judge.motions import SIMULATED, simulated_motion
from hiltest.judge.own_calibrators import own_calibrators
from hiltest.judge.worlds import DEFAULT_CLOUDS, FAMILIES, HALF_SPHERE, RIG, WORLDS, World, draw_worlds
from hiltest.measurement.estimates import Estimate
from hiltest.orientation import attitude_filter
from hiltest.orientation.motion_recording import MotionRecording, read_motion_recording
from hiltest.run_record.files import write_atomically
from hiltest.session.progress_line import ProgressLine
from hiltest.text import format_number

PAGE = Path(__file__).with_suffix(".md")
FOLDER = Path(__file__).with_suffix("")
RESULTS, PACKAGES = FOLDER / "results.json", FOLDER / "requirements.txt"
HARDWARE = FOLDER / "hardware_fxos8700cq.py"
MOTIONS = 5
"""Number of simulated motions."""
IN_C, IN_PYTHON, IN_HARDWARE = OWN = "hiltest C", "hiltest float64", "FXOS8700CQ"
CALIBRATOR_HEADINGS = ("all worlds", "99 %", "worst [deg]", "no answer", "cycles", "compiler")
ERRORS = ("total [deg]", "heading [deg]", "inclination [deg]", "simulated, total [deg]")
FILTER_HEADINGS = ("", "filter", "from", *ERRORS, "cycles", "compiler")

HEAD = """\
# Leaderboard

`hiltest judge` has judged the calibrators and filters of this page: those of hiltest, and those of {packages}
packages that `pip` installs. Each row can be reproduced:

```sh
pip install . -r docs/leaderboard/requirements.txt     # in a checkout of hiltest
python docs/leaderboard.py                             # calibrators: a quarter of an hour
python docs/leaderboard.py --recordings broad          # and filters, on the .npz files of a folder: an hour or two
hiltest judge docs/leaderboard/calibrators_magcc.py:magcc_lm
hiltest judge docs/leaderboard/filters.py:Vqf --recording broad/07_undisturbed_fast_rotation_B.npz
```

The last two commands judge a single entry. Recordings have the layout of [judge.md](judge.md#filters).
`docs/leaderboard.py` keeps each result in [results.json](leaderboard/results.json) as soon as it has it, and judges an
entry again only if its adapter, its version or the worlds have changed. After an interruption it goes on where it was.
`--page` writes the page only.

Numbers in parentheses are intervals at 95 % confidence. If the intervals of two entries overlap, their order says
nothing.

## Calibrators

Errors are multiples of the Cramér-Rao bound, root mean squares over worlds with an answer:
[judge.md](judge.md#numbers) has the definitions. The order is that of `hiltest judge`, by the larger error in two
families: `rig`, the default rig, in which most fits are equal, and `{second}`, {title}, in which they differ. An
entry without an answer in more than half of the worlds of one of them has no place. `worst` is the largest heading
error over the poses of the default rig, the median over its worlds. *No answer* counts refusals and answers that are
no ellipsoids, of all worlds.
"""

CALIBRATORS = """\
`m_acal` is the automatic hard-iron calibration in the FXOS8700CQ: the middle of the extremes of each axis, without a
soft iron. It also errs by the noise of single samples, which the extremes are.

`ellipsoid_fit` of magcal takes the mean of the samples for the centre. The default rig spreads its samples evenly
over the sphere, so that there the mean is nearer the centre than any fit, and below the bound; it is far from it in
all other worlds. `calibrate` of this package refuses fewer than 500 samples, so its functions are called without it.
`cal_mag_ellipsoid_fit` of navlib builds its matrix from the transposed eigenvectors: a sphere with the same centre
errs less. `calibrate_lse` of magcc applies a triangular matrix, which turns the field.

Errors in the other families:
"""

FILTERS = """\
## Filters

Errors are those of the benchmark [BROAD](https://doi.org/10.3390/data6070072): means over {recordings} of its trials,
in which cameras saw the true attitude. The order is that of the total error. The intervals are Student's, over the
trials, which differ much; so they say how sure the mean over such trials is, and the rows below compare filters trial
by trial. The simulated motion is that of `hiltest judge`, with {motions} seeds of the noise.
"""

TRIALS = """\
Total error of each trial [deg], by the number of the trial:
"""

RULES = """\
## Rules of entry

1. Anyone can install the package with `pip`. Its code stays there; this repository has an adapter of a few lines,
   such as [calibrators_magcc.py](leaderboard/calibrators_magcc.py), or [filters.py](leaderboard/filters.py).
2. Parameters are the package's defaults. Exceptions are facts that a package asks for and that a user knows: rate of
   the samples, field strength (48.5 uT), dip of the field (from the first reading) and noise of the sensors (0.4 uT).
   One set of parameters is used in all worlds and motions.
3. A calibration is the one that the package applies. A package that fits ellipsoids and applies nothing gets the
   symmetric matrix of its ellipsoid; one that fits a sphere gets the identity.
4. A filter gets one reading at a time, without the bias that the gyroscope had at rest before the motion. It starts
   from the first reading, if the package does so with a recording. Filters that need the whole recording are left
   out.
5. Cycles are those of one calibration of 100 points, or of one update, on the virtual Cortex-M4. Python has none.

To enter, add a file of adapters for the package, or a class to filters.py, and the package with its version to
[requirements.txt](leaderboard/requirements.txt); then run the command.

## Worlds and motions

A digest is that of everything an entry gets and of the truth, rounded to 1e-6. If yours differ, so do the worlds.
"""

PACKAGES_TEXT = """\
Packages: {packages}.

Left out: scikit-guess 0.0.2 cannot be imported with NumPy 2. attipy and smsfusion take a heading where others take
the field. The calibrations of qmt, pywayne and magyc need a gyroscope. The filters of navlib, and `Complementary` and
`FKF` of ahrs, take whole recordings only.
"""


@dataclass(frozen=True)
class Row:
    """Result of an entry: one of a calibrator or one of a filter."""

    name: str
    source: str
    """Package and version."""
    digest: str
    """Digest of the adapter, of the version and of the worlds or motions."""
    calibrator: EntryResult | None = None
    filter: FilterResult | None = None


@dataclass(frozen=True)
class Results:
    """All results."""

    worlds: dict[str, str] = field(default_factory=dict)
    """Digest of the worlds of each family."""
    motions: dict[str, str] = field(default_factory=dict)
    """Digest of each motion."""
    rows: tuple[Row, ...] = ()


@dataclass(frozen=True)
class Candidate:
    """An entry to judge."""

    name: str
    source: str
    code: bytes
    """Its own part of the digest."""
    open: Callable[[], AbstractContextManager[Any]]


# -- worlds, motions and their digests ------------------------------------------------------------------------------


def world_digests() -> dict[str, str]:
    """Return a digest of the worlds of each family: of all that calibrators get, and of the truth."""
    return {family.name: _digest(_world_content(world) for world in draw_worlds(family)) for family in FAMILIES}


def _world_content(world: World) -> bytes:
    # Rounded, because the last digit of a sine is not the same on every host.
    parts = (world.samples_ut, world.accelerations_g, world.soft_iron, world.hard_iron_ut, world.poses.field_ut)
    return b"".join(np.rint(1e6 * part).astype("<i8").tobytes() for part in parts)


def _motion_digest(motion: MotionRecording) -> str:
    parts = (*readings_of(motion), np.nan_to_num(motion.truth), motion.movement)
    return _digest(np.rint(1e6 * np.asarray(part)).astype("<i8").tobytes() for part in parts)


def _digest(parts: Iterable[bytes]) -> str:
    total = sha256()
    for part in parts:
        total.update(part)
    return total.hexdigest()[:16]


# -- entries --------------------------------------------------------------------------------------------------------


class ReferenceEntry:
    """A float64 reference as an entry."""

    built_by = cycle_model = ""
    flash_bytes: int | None = None

    def __init__(self, name: str, calibrator: Calibrator) -> None:
        self.name, self._calibrator = name, calibrator

    def answer(self, world: World) -> Answer:
        """Calibrate from the samples of a world."""
        fit = self._calibrator(np.rint(COUNTS_PER_UT * world.samples_ut))
        return Answer(not fit.has_fit, fit.hard_iron / COUNTS_PER_UT, fit.soft_iron)


class ReferenceFilter:
    """The float64 reference of the attitude filter as an entry."""

    name = "attitude_filter"
    built_by = cycle_model = ""

    def follow(self, motion: MotionRecording) -> FilterAnswers:
        """Follow a motion."""
        stride = stride_of(motion)
        attitudes = attitude_filter.filter_attitudes(*readings_of(motion), motion.rate_hz)
        places = np.arange(stride - 1, len(attitudes) - len(attitudes) % stride, stride)
        return FilterAnswers(places, attitudes[places], None, np.empty(0))


def own_calibrator_candidates() -> list[Candidate]:
    """Return the calibrators of the firmware, the float64 references, and the calibration of a magnetometer itself."""
    firmware = default_firmware().read_bytes()
    sources = b"".join(file.read_bytes() for file in sorted(Path(hiltest.calibration.__file__).parent.glob("*.py")))
    return [
        *(Candidate(entry.name, IN_C, firmware, partial(nullcontext, entry)) for entry in own_calibrators()),
        *(
            Candidate(name, IN_PYTHON, sources, partial(nullcontext, ReferenceEntry(name, calibrator)))
            for name, calibrator in REFERENCES.items()
        ),
        Candidate("m_acal", IN_HARDWARE, HARDWARE.read_bytes(), partial(open_entry, f"{HARDWARE}:m_acal", None)),
    ]


def own_filter_candidates() -> list[Candidate]:
    """Return the attitude filter of the firmware and its float64 reference."""
    code = Path(attitude_filter.__file__).read_bytes()
    filters = [(OwnFilter(), IN_C, default_firmware().read_bytes()), (ReferenceFilter(), IN_PYTHON, code)]
    return [Candidate(entry.name, source, content, partial(nullcontext, entry)) for entry, source, content in filters]


def package_candidates(file: Path, opened: Callable[[str], AbstractContextManager[Any]]) -> Iterator[Candidate]:
    """Yield the entries of an adapter file whose packages are installed."""
    nodes = ast.parse(file.read_text(encoding="utf-8")).body
    public = {node.name: node for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    public = {name: node for name, node in public.items() if not name.startswith("_")}
    # Without comments, layout and the docstring of the module.
    shared = [ast.unparse(node) for node in nodes if node not in public.values() and not isinstance(node, ast.Expr)]
    for name, node in public.items():
        package, _, title = (ast.get_docstring(node) or "").splitlines()[0].partition(" ")
        try:
            source = f"{package} {version(package)}"
        except PackageNotFoundError:
            print(f"{package} is not installed, so {name} is not judged: pip install -r {PACKAGES}", file=sys.stderr)
            continue
        code = "\n".join([source, *shared, ast.unparse(node)]).encode()
        yield Candidate(title, source, code, partial(opened, f"{file}:{name}"))


# -- judging --------------------------------------------------------------------------------------------------------


def judge_calibrators(progress: ProgressLine) -> None:
    """Judge the calibrators whose digest has changed."""
    worlds = world_digests()
    adapters = [
        candidate
        for file in sorted(FOLDER.glob("calibrators_*.py"))
        for candidate in package_candidates(file, lambda named: open_entry(named, None))
    ]
    _renew_all([*own_calibrator_candidates(), *adapters], worlds, _judge_calibrator, progress)
    _keep(worlds=worlds)


def judge_filters(recordings: Path, progress: ProgressLine) -> None:
    """Judge the filters whose digest has changed, on simulated motions and on the recordings of a folder."""
    motions = [simulated_motion(number + 1) for number in range(MOTIONS)]
    motions += [read_motion_recording(file) for file in sorted(recordings.glob("*.npz"))]
    digests = {motion.name: _motion_digest(motion) for motion in motions}
    packages = package_candidates(FOLDER / "filters.py", open_filter)
    _renew_all([*own_filter_candidates(), *packages], digests, partial(_judge_filter, motions), progress)
    _keep(motions=digests)


def _renew_all(
    candidates: Sequence[Candidate],
    inputs: Mapping[str, str],
    judged: Callable[[Row, Any, Callable[[int, int], None]], Row],
    progress: ProgressLine,
) -> None:
    for number, candidate in enumerate(candidates):
        _renew(candidate, inputs, judged, partial(progress, f"{number + 1} of {len(candidates)}: {candidate.name}"))
    progress.clear()


def _judge_calibrator(row: Row, entry: Entry, tell: Callable[[int, int], None]) -> Row:
    done, total = count(), WORLDS * len(FAMILIES)
    result = judge(entry, "", lambda _world: tell(next(done), total)).result
    return replace(row, calibrator=replace(result, cost=replace(result.cost, host_us=None)))


def _judge_filter(
    motions: Sequence[MotionRecording], row: Row, entry: JudgedFilter, tell: Callable[[int, int], None]
) -> Row:
    done = count()
    result = judge_filter(entry, "", motions, lambda _motion: tell(next(done), len(motions)))
    scores = tuple(score for score in result.scores if score.phase == MOTION)
    return replace(row, filter=replace(result, host_us=None, scores=scores))


def _renew(
    candidate: Candidate,
    inputs: Mapping[str, str],
    judged: Callable[[Row, Any, Callable[[int, int], None]], Row],
    tell: Callable[[int, int], None],
) -> None:
    """Judge an entry unless its result is there, and keep the result at once."""
    digest = _digest([candidate.code, *(f"{name} {value}".encode() for name, value in inputs.items())])
    row = Row(candidate.name, candidate.source, digest)
    if any(other.digest == digest and _key(other) == _key(row) for other in read_results().rows):
        return
    with candidate.open() as entry:
        row = judged(row, entry, tell)
    others = [other for other in read_results().rows if _key(other) != _key(row)]
    _keep(rows=tuple(sorted([*others, row], key=_key)))


def _key(row: Row) -> tuple[str, str]:
    """Return package and name, which another version of the package replaces."""
    return row.source if row.source in OWN else row.source.split()[0], row.name


def _keep(**changes: Any) -> None:
    write_atomically(RESULTS, json_text(replace(read_results(), **changes)) + "\n")


def read_results() -> Results:
    """Return the results."""
    return read_as(RESULTS, Results, otherwise="delete it, and judge all entries") if RESULTS.exists() else Results()


# -- page -----------------------------------------------------------------------------------------------------------


def page(results: Results) -> str:
    """Return the text of the page."""
    calibrators = sorted(
        (row for row in results.rows if row.calibrator),
        key=lambda row: (_result(row).rank_error, row.name, row.source),
    )
    filters = sorted((row for row in results.rows if row.filter), key=_filter_error)
    recordings = [name for name in results.motions if _is_recorded(name)]
    titles = {family.name: family.title for family in FAMILIES}
    others = [name for name in results.worlds if name not in DEFAULT_CLOUDS]
    sources = sorted({row.source for row in results.rows if row.source not in OWN}, key=str.lower)
    lines = [
        HEAD.format(second=HALF_SPHERE, title=titles[HALF_SPHERE], packages=len(sources)),
        *_table(
            ["", "calibrator", "from", f"`{RIG}`", f"`{HALF_SPHERE}`", *CALIBRATOR_HEADINGS],
            [_calibrator_cells(number + 1, row) for number, row in enumerate(calibrators)],
        ),
        CALIBRATORS,
        *_table(
            ["calibrator", "from", *(f"`{name}`" for name in others)],
            [[row.name, row.source, *(_cell(_result(row).family(name).rms) for name in others)] for row in calibrators],
        ),
        FILTERS.format(recordings=len(recordings), motions=len(results.motions) - len(recordings)),
        *_table(
            FILTER_HEADINGS,
            [_filter_cells(number + 1, row) for number, row in enumerate(filters)],
        ),
        TRIALS,
        *_table(
            ["filter", "from", *(name[:2] for name in recordings)],
            [[row.name, row.source, *(f"{_totals(row)[name]:.2f}" for name in recordings)] for row in filters],
        ),
        RULES,
        *_table(
            ["worlds", "digest"], [[f"`{name}`: {titles[name]}", f"`{text}`"] for name, text in results.worlds.items()]
        ),
        *_table(
            ["motion", "digest"],
            [[name.removesuffix(".npz"), f"`{text}`"] for name, text in results.motions.items()],
        ),
        PACKAGES_TEXT.format(packages=", ".join(sources)),
    ]
    return "\n".join(lines)


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(headings)} |"
    yield "|---" * len(headings) + "|"
    yield from (f"| {' | '.join(row)} |" for row in rows)
    yield ""


def _result(row: Row) -> EntryResult:
    assert row.calibrator is not None
    return row.calibrator


def _calibrator_cells(place: int, row: Row) -> list[str]:
    result = _result(row)
    whole, rig = result.family(ALL), result.family(RIG)
    return [
        str(place) if math.isfinite(result.rank_error) else "",
        row.name,
        row.source,
        *(_cell(result.family(name).rms) for name in (*DEFAULT_CLOUDS, ALL)),
        _cell(whole.p99),
        _cell(rig.worst_deg),
        str(whole.unanswered),
        format_number(result.cost.cycles) if result.cost.cycles else "",
        compiler_in(result.built_by),
    ]


def _filter_error(row: Row) -> float:
    return _mean_over(row, "total", _is_recorded)[0]


def _filter_cells(place: int, row: Row) -> list[str]:
    assert row.filter is not None
    return [
        str(place),
        row.name,
        row.source,
        *(_mean_cell(_mean_over(row, error, _is_recorded)) for error in ("total", "heading", "inclination")),
        _mean_cell(_mean_over(row, "total", lambda motion: not _is_recorded(motion))),
        format_number(row.filter.cycles) if row.filter.cycles else "",
        compiler_in(row.filter.built_by),
    ]


def _totals(row: Row) -> dict[str, float]:
    assert row.filter is not None
    return {score.motion: score.total_deg or math.nan for score in row.filter.scores}


def _mean_over(row: Row, error: str, chosen: Callable[[str], bool]) -> tuple[float, float]:
    """Return the mean of an error over motions, and half of its interval at 95 % by Student's distribution."""
    assert row.filter is not None
    errors = [getattr(score, f"{error}_deg") for score in row.filter.scores if chosen(score.motion)]
    half = student.ppf(0.975, len(errors) - 1) * stdev(errors) / math.sqrt(len(errors))
    return fmean(errors), float(half)


def _is_recorded(motion: str) -> bool:
    return motion.partition("/")[0] != SIMULATED


def _mean_cell(mean: tuple[float, float]) -> str:
    value, half = mean
    return f"{value:.2f} ({max(value - half, 0.0):.2f} to {value + half:.2f})"


def _cell(estimate: Estimate | None) -> str:
    if estimate is None:
        return "-"
    low, high = ("?" if end is None else f"{end:.2f}" for end in (estimate.low, estimate.high))
    return f"{estimate.value:.2f} ({low} to {high})"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=Path, metavar="FOLDER", help="judge the filters, too, on these recordings")
    parser.add_argument("--page", action="store_true", help="only write the page")
    options = parser.parse_args()
    if not options.page:
        line = ProgressLine(ErrorOutput(), shown=sys.stderr.isatty(), say=lambda text: print(text, file=sys.stderr))
        judge_calibrators(line)
        if options.recordings is not None:
            judge_filters(options.recordings, line)
    write_atomically(PAGE, page(read_results()))
