"""Pages to look at, and the browser that looks at them: Debian's Chromium, driven by Playwright."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hiltest.calibration.allan import allan_curve
from hiltest.log_fitting import FieldUnit, Samples
from hiltest.log_fitting.allan_page import write_page
from hiltest.log_fitting.rate_log import RateLog, RateUnit
from hiltest.log_fitting.sample_fit import fit_on_host
from hiltest.log_fitting.sample_fit_page import fit_page
from hiltest.measurement import EXACT, Better, Limit, Measurement, Outcome, check
from hiltest.procedures.golden_points import golden_points
from hiltest.report.boards_page import Apart, BoardLine, boards_html
from hiltest.report.render import html_report
from hiltest.report.trend.folder import Skipped
from hiltest.report.trend.outputs import trend_page
from hiltest.report.trend.series import RunEntry, trend_of
from hiltest.run_record.comparison import Change, Comparison, Difference, Side
from hiltest.run_record.outcomes import TestOutcome
from hiltest.run_record.reader import read_record
from hiltest.run_record.run import Column, Findings, Run, Table, TestResult, Verdict
from hiltest.studies.study import study_of
from hiltest.studies.study_page import page as study_page
from hiltest.verdict.verdict import decide

from ...trend.entries import cycles, degrees, entry

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

# Of a page that is read from a file; a machine with other work may still take seconds.
WAIT_MS = 60_000
HOSTILE = "<script>document.title='taken'</script>\"'‮" + "long" * 40
SIDE = Side("base.json", "ab" * 32, "hiltest-frdm-k64f", "0.1.0", "0123", "GCC 12.2.1", "m", "virtual-k64f", (1,), "")


@dataclass
class Visit:
    """A page that is open, and what happened while it was."""

    page: Page
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)


@pytest.fixture(scope="module")
def browser(require_tool: Callable[[str], str], require_module: Callable[[str], None]) -> Iterator[Browser]:
    chromium = require_tool("chromium")  # before its driver, which does not start on every system without it
    require_module("playwright")
    from playwright.sync_api import sync_playwright

    # As root, as in a container, Chromium starts only without its sandbox; the pages are our own.
    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture(scope="module")
def canvas(browser: Browser) -> Page:
    """An empty page, to look at pictures with."""
    return browser.new_page()


@pytest.fixture
def visit(browser: Browser) -> Callable[..., AbstractContextManager[Visit]]:
    """Return a function that opens a file at a width, with everything on it unfolded."""

    @contextmanager
    def opened(path: Path, *, width: int, scheme: str = "light") -> Iterator[Visit]:
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)  # type: ignore[arg-type]
        page.set_default_timeout(WAIT_MS)
        result = Visit(page)
        page.on("request", lambda request: result.requests.append(request.url))
        page.on("console", lambda message: result.complaints.append(message.text))
        page.on("pageerror", lambda error: result.complaints.append(str(error)))
        page.goto(path.as_uri())
        page.evaluate("document.querySelectorAll('details').forEach(each => each.open = true)")
        yield result
        page.close()

    return opened


@pytest.fixture
def everything(findings: Callable[..., Findings], good: list[Measurement]) -> Run:
    """A green run with all that a run can have, compared with a baseline."""
    run = findings(*good, *stream_measurements(), *imu_measurements())
    run.tables.update((item.name, item) for item in (poses_with_tilt(run), faces_table(), noise_table(), motion()))
    return replace(finished(run), comparison=compared())


@pytest.fixture
def red(everything: Run, heading: Callable[..., list[Measurement]], findings: Callable[..., Findings]) -> Run:
    """Everything, out of its limits, and a comparison that could not be made."""
    bad = heading("direct", 6.3, limit=0.3, cycles=12_400)
    failed = TestResult("t.py::t", TestOutcome.FAILED, 1, reason="out of limit", trace="wire/t.log")
    run = findings(*bad, tests=(failed,))
    blocked = Comparison(SIDE, SIDE, (), ("the base is of another rig; run on that one",), "Not judged.")
    return replace(finished(run), comparison=blocked, tables=everything.tables)


@pytest.fixture
def nothing(findings: Callable[..., Findings]) -> Run:
    """No board, no rig, no measurement."""
    run = findings(tests=(TestResult("t", TestOutcome.CONNECTION_LOST, 0, reason="no port"),), tables=False)
    run.board = run.rig = None
    return finished(run)


@pytest.fixture
def cut_short(findings: Callable[..., Findings], good: list[Measurement]) -> Run:
    """What is left of a run that was killed."""
    run = finished(findings(*good[:3]))
    return replace(run, verdict=replace(run.verdict, outcome="interrupted", complete=False), tests=())


@pytest.fixture
def hostile(findings: Callable[..., Findings]) -> Run:
    """Names that would be markup, or would turn or hide what stands around them."""
    run = findings(
        check(f"heading.{HOSTILE}.max", 1.0, unit=HOSTILE, limit=Limit(max=2)),
        check(HOSTILE, 1.0, unit="uT"),
        tests=(TestResult(HOSTILE, TestOutcome.FAILED, 1, reason=HOSTILE, trace="javascript:alert(1)"),),
    )
    assert run.board is not None
    run.board = replace(run.board, firmware=HOSTILE, description=HOSTILE, calibrators=(HOSTILE,))
    run.tables["cycles.sizes"] = Table("cycles.sizes", (Column("n"), Column(HOSTILE, "cycle")), ((20, 100), (40, 190)))
    return finished(run)


@pytest.fixture(
    params=["everything", "red", "nothing", "cut_short", "hostile", "fit", "allan", "trend", "study", "boards"]
)
def page_file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Each page in turn, as the file that a user opens."""
    path = tmp_path / f"{request.param}.html"
    if request.param == "fit":
        cloud = Samples(Path("cloud.csv"), golden_points(300) / 10.0, FieldUnit.UT, "option", ("x", "y", "z"), 0)
        path.write_text(fit_page(fit_on_host(cloud), cloud), encoding="utf-8")
    elif request.param == "allan":
        rates = np.random.default_rng(1).normal(size=(2000, 3))
        log = RateLog(Path("still.csv"), ("x", "y", "z"), rates, RateUnit.DPS, 100.0, len(rates), 0)
        write_page(log, allan_curve(rates, rate_hz=100.0), path)
    elif request.param == "study":
        record = read_record(Path(__file__).parents[3] / "docs" / "studies" / "float32.json").run
        path.write_text(study_page(study_of("float32"), record), encoding="utf-8")
    elif request.param == "boards":
        path.write_text(boards_html(*four_boards()), encoding="utf-8")
    elif request.param == "trend":
        path.write_text(trend_page(trend_of(runs()), [Skipped(HOSTILE, HOSTILE)]), encoding="utf-8")
    else:
        path.write_text(html_report(request.getfixturevalue(request.param)), encoding="utf-8")
    return path


def four_boards() -> tuple[Verdict, list[BoardLine], list[Apart]]:
    """Return four boards, one of them with a measurement out of its limit and a name that would be markup."""
    names = ("frdm-k64f", "stm32f411-disco", "microbit-v1", HOSTILE)
    boards = [
        BoardLine(name, name, int(name == HOSTILE), f"of {name}: the worst error is 1 deg.", name) for name in names
    ]
    outcomes = {name: Outcome.FAIL if name == HOSTILE else Outcome.PASS for name in names}
    values = dict.fromkeys(names, 0.95)
    apart = [Apart(f"heading.{name}.max", "deg", values, outcomes, 0.1) for name in ("direct", "corrected", "li")]
    return Verdict("failed", 1, "FAIL on 1 of 4 boards.", complete=True), boards, apart


def runs() -> list[RunEntry]:
    """Return runs with steps, on two rigs, one of them with names that would be markup."""
    names = ("heading.direct.max", HOSTILE, "fit.direct.residual", "link.errors")
    results = [
        entry(day, cycles(11_061 + 100 * (day > 4)), *(degrees(1.0 + 0.5 * (day > 6), name) for name in names))
        for day in range(1, 9)
    ]
    other = entry(9, cycles(90_000), rig="another", build=HOSTILE, file=HOSTILE)
    campaign = entry(10, seeds={seed: (cycles(11_000 + seed),) for seed in range(1, 5)})
    return [*results, other, campaign]


def finished(run: Findings) -> Run:
    return run.finish(decide(run, pytest_exit=0), "2026-01-02T03:05:00Z")


def stream_measurements() -> list[Measurement]:
    cycles = {"cycles_mean": 246.03, "cycles_max": 255.0, "fit_cycles": 3503}
    return [
        check("heading.slow-stream.max", 2.42, unit="deg"),
        *(check(f"stream.slow-stream.{name}", value, unit="cycle", cycle_model="m") for name, value in cycles.items()),
    ]


def imu_measurements() -> list[Measurement]:
    limited = {
        "accelerometer.norm_rms": (0.44, "mg", Limit(max=1.0)),
        "accelerometer.tilt_error": (0.12, "deg", Limit(max=0.5)),
        "gyroscope.noise_density": (24.4, "mdps/rtHz", Limit(22.5, 27.5)),
        "gyroscope.scale_error": (-0.01, "%", Limit.within(0.1)),
        "fusion.heading.rms": (1.2, "deg", Limit(max=0.9)),
        "gyroscope.uncorrected_error": (2.1, "dps", None),
        "heading.uncalibrated.max": (11.5, "deg", None),
        "tumble.coverage": (85.9, "%", None),
    }
    return [check(name, value, unit=unit, limit=limit) for name, (value, unit, limit) in limited.items()]


def poses_with_tilt(run: Findings) -> Table:
    table = run.tables["heading.poses"]
    answered = [(0.99 * row[1], 1.01 * row[2]) for row in table.rows]  # type: ignore[operator]
    columns = (*table.columns, Column("answered_pitch", "deg"), Column("answered_roll", "deg"))
    rows = tuple((*row, *tilt) for row, tilt in zip(table.rows, answered, strict=True))
    return Table(table.name, columns, rows)


def faces_table() -> Table:
    rows = ((8220, -10, 29), (-8195, 3, 16), (25, 8168, 4), (-3, -8192, 11), (-5, 1, 8215), (6, -28, -8184))
    return Table("accelerometer.six_position.poses", tuple(Column(axis, "count") for axis in "xyz"), rows)


def noise_table() -> Table:
    columns = (Column("axis"), Column("density", "mdps/rtHz"))
    return Table("gyroscope.noise_density", columns, (("x", 25.2), ("y", 23.8), ("z", 24.3)))


def motion() -> Table:
    names = ("time", "heading", "fused", "accelerometer_magnetometer", "gyroscope")
    rows = tuple((0.1 * k, k, 0.3 * math.sin(k), 2 * math.sin(7 * k), 0.001 * k) for k in range(100))
    return Table("fusion.motion", tuple(Column(name) for name in names), rows)


def compared() -> Comparison:
    numbers = {
        Change.BETTER: (200.0, 150.0),
        Change.WORSE: (11_061.0, 11_161.0),
        Change.NEW: (None, 3.0),
        Change.GONE: (3.0, None),
        Change.UNCHANGED: (1.0, 1.0),
        Change.CHANGED: (30.0, 90.0),
    }
    differences = tuple(
        Difference(
            f"cycles.{change}.total",
            "cycle",
            change,
            Better.LOWER,
            base,
            new,
            None if base is None or new is None else new - base,
            None,
            1,
            EXACT,
            Limit(max=12_500),
            "pass",
            "m",
        )
        for change, (base, new) in numbers.items()
    )
    return Comparison(SIDE, SIDE, differences, (), "1 worse, 1 gone: not to be merged.")
