"""Results of firmware whose sensors play a recording: its own calibration and headings, and hiltest's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hiltest import __version__
from hiltest.boards import Board, open_board
from hiltest.calibration.accelerometer import NOMINAL
from hiltest.calibration.fit import MagnetometerFit
from hiltest.calibration.quality import residual_percent
from hiltest.errors import ConfigError
from hiltest.interfaces.quantities import Quantity, values_of
from hiltest.interfaces.sensor_files.recorded_motion import load_playback
from hiltest.link.messages import Average, SetCalibration
from hiltest.link.replies import AverageReply
from hiltest.orientation import DegenerateFieldError
from hiltest.orientation.attitude_errors import attitude_errors, phases
from hiltest.orientation.motion_recording import MotionRecording
from hiltest.procedures.calibrate import CalibratorRun, run_calibrators
from hiltest.procedures.fusion import record_motion
from hiltest.procedures.known_angles import Reals
from hiltest.procedures.progress import Progress
from hiltest.procedures.reported_headings import CALIBRATED, FIRMWARE, Belief, belief_of, frame_of
from hiltest.procedures.requested_headings import headings_deg
from hiltest.procedures.rest import rest_gyroscope
from hiltest.procedures.tumble import Tumble, collect_until
from hiltest.rig import COUNTS_PER_UT, Rig

# Calibrators of hiltest's firmware; of other firmware with its protocol, those of them that it has, otherwise all.
_OURS = ("direct", "corrected", "iterative")
FILTER = "attitude filter"
"""Name of the filter among attitudes."""
# Number of new samples per heading of a moving board: 50 ms of the slowest magnetometer, 20 ms of the others.
_READINGS = 4
# Rest before a motion with true attitudes: the bias is taken from its first half, and the filter begins in the second.
_SHORTEST_REST_S, _LONGEST_BIAS_S = 2.0, 20.0
# The firmware's longest run of its filter, less a second for its end. It ends before the last readings, which are held.
_LONGEST_RUN_S, _HELD_S = 299.0, 0.5


@dataclass(frozen=True, slots=True)
class PlayedRow:
    """Results by firmware or calibrator."""

    name: str
    hard_iron_ut: tuple[float, ...] | None
    """Hard iron along x, y and z of the board."""
    field_ut: float | None
    """Radius of the sphere with the volume of its ellipsoid; or the firmware's own value."""
    said_error_percent: float | None
    """Fit error that the firmware reports, by its own definition."""
    residual_percent: float | None
    """``100 rms(|corrected| / field - 1)`` over the same points for all."""
    cycles: int | None
    heading_deg: tuple[float | None, ...]
    """Heading at each moment."""


@dataclass(frozen=True, slots=True)
class PlayedAttitude:
    """Errors of an attitude against the recorded one [deg rms], as `hiltest.orientation.attitude_errors` has them."""

    name: str
    """``attitude filter``; ``accelerometer and magnetometer`` or ``gyroscope``, each alone."""
    phase: str
    """``motion``, the benchmark's; for the filter also other phases."""
    total_deg: float
    heading_deg: float
    inclination_deg: float
    samples: int
    """Number of attitudes that count."""


@dataclass(frozen=True, slots=True)
class Played:
    """Results of firmware from a recording."""

    hiltest: str
    playing: str
    """Version, and the recording in words."""
    points: int
    """Number of points of the magnetometer."""
    moments_s: tuple[float, ...]
    """Times of the headings, relative to the recording's beginning."""
    remarks: tuple[str, ...]
    """Further remarks."""
    found: tuple[PlayedRow, ...]
    """If the rig's firmware does not use hiltest's protocol: ``firmware``, its own headings, and ``calibrated``, its
    calibration on the readings of hiltest's firmware; then hiltest's calibrators."""
    attitudes: tuple[PlayedAttitude, ...] = ()
    """Errors of the filter of hiltest's firmware for a recording with true attitudes; the others are empty then."""

    def filter_errors(self) -> dict[str, PlayedAttitude]:
        """Return the errors of the filter by phase."""
        return {row.phase: row for row in self.attitudes if row.name == FILTER}


def play_back(
    rig: Rig,
    playing: str,
    times_s: Reals,
    moments_s: Reals,
    *,
    begins_s: float,
    firmware: Path | None,
    progress: Progress,
) -> Played:
    """Play a rig's recording to its firmware and to hiltest's, each from power-on.

    Parameters
    ----------
    rig
        Rig of a virtual board, with a recording.
    playing
        The recording in words.
    times_s : shape (n,)
        Virtual times of the recorded readings of the magnetometer.
    moments_s : shape (n,)
        Virtual times of the headings.
    begins_s
        Virtual time of the recording's beginning.
    firmware
        Firmware of the rig's board.

    Notes
    -----
    hiltest's firmware plays the recording twice: it calibrates in the first pass, and answers headings in the second.
    """
    remarks: list[str] = []
    foreign: tuple[PlayedRow, Belief] | None = None
    if not rig.answers_requests:
        with open_board(rig, firmware=firmware) as board:
            foreign = _listen(board, float(times_s[-1]), moments_s, progress)
            remarks += board.stage.said_of_playback if board.stage else []
        firmware = None
        rig = replace(rig, device=None, cycles={}, board=replace(rig.board, firmware=None))
    with open_board(rig, firmware=firmware) as board:
        tumble, runs = _calibrate(board, times_s, rig.procedure.tumble_points, progress)
        remarks += board.stage.said_of_playback if board.stage else []
    with open_board(rig, firmware=firmware) as board:
        replies = _ask_headings(board, moments_s, runs, progress)
    ours = [_hiltest_result(run, replies) for run in runs.values()]
    theirs = [] if foreign is None else _firmware_results(*foreign, tumble, replies)
    return Played(
        hiltest=__version__,
        playing=playing,
        points=len(tumble.points),
        moments_s=tuple((moments_s - begins_s).tolist()),
        remarks=tuple(dict.fromkeys(remarks)),
        found=(*theirs, *ours),
    )


def follow_recordings(rig: Rig, *, firmware: Path | None, base: int | None, progress: Progress) -> dict[str, Played]:
    """Follow each of a rig's recorded motions on a board of its own.

    Parameters
    ----------
    rig
        Rig of a virtual board, with ``world.motion_recordings``.
    firmware, base
        Firmware of all boards, and the address of a raw binary.

    Returns
    -------
    dict
        Results by the name of the recording.

    Raises
    ------
    ConfigError
        If a file is no recording with true attitudes, or the filter cannot follow it.
    """
    return {
        name: follow_recording(rig.playing(file), firmware=firmware, base=base, progress=progress)
        for name, file in rig.motion_recordings().items()
    }


def follow_recording(rig: Rig, *, firmware: Path | None, base: int | None = None, progress: Progress) -> Played:
    """Play a rig's recording with true attitudes to hiltest's firmware, which follows it with its filter.

    The gyroscope's bias is taken from the rest before the motion. The recording is calibrated, so the board's
    calibrations are units alone.

    Parameters
    ----------
    rig
        Rig of a virtual board, with a recording.
    firmware, base
        Firmware of the board, and the address of a raw binary.

    Raises
    ------
    ConfigError
        If the recording cannot be read, has no true attitudes, no rest before the motion, or is too long.
    """
    playback = load_playback(rig)
    assert playback is not None
    motion = playback.motion
    if motion is None:
        raise ConfigError(
            f"{playback.name} has no true attitudes; name a NumPy archive in the layout of BROAD, as docs/playback.md "
            "describes it"
        )
    bias_s = _bias_time_s(motion)
    with open_board(rig, firmware=firmware, base=base) as board:
        attitudes = _follow(board, motion, playback.begins_s, bias_s, progress)
        remarks = board.stage.said_of_playback if board.stage else []
    return Played(__version__, playback.described(), len(motion.movement), (), tuple(remarks), (), attitudes)


def _listen(board: Board, end_s: float, moments_s: Reals, tell: Progress) -> tuple[PlayedRow, Belief]:
    """Listen to firmware for the length of a recording, and long enough for its last fit."""
    output = board.output
    frame = frame_of(output.rig)
    headings: list[float | None] = []
    for number, moment_s in enumerate(moments_s.tolist()):
        tell("the rig's firmware", number, len(moments_s))
        observations = output.observe(max(0.0, moment_s - board.now_s()))
        heard = values_of(observations, Quantity.HEADING)
        headings.append(frame.heading_deg(float(heard[-1][0])) if heard else None)
    output.observe(max(0.0, end_s - board.now_s()) + output.device.settle_s)
    tell("the rig's firmware", len(moments_s), len(moments_s))
    belief = belief_of(output.latest, frame)
    calibrated = output.latest.get(Quantity.CALIBRATED)
    if calibrated is not None and not calibrated.any():
        return PlayedRow(f"{FIRMWARE} (not calibrated)", None, None, None, None, None, tuple(headings)), Belief()
    firmware = PlayedRow(
        FIRMWARE,
        None if belief.hard_iron_ut is None else tuple(belief.hard_iron_ut.tolist()),
        belief.field_strength_ut,
        belief.fit_error_percent,
        None,
        None,
        tuple(headings),
    )
    return firmware, belief


def _calibrate(board: Board, times_s: Reals, points: int, tell: Progress) -> tuple[Tumble, dict[str, CalibratorRun]]:
    """Collect points from a recording, and fit them on the board."""
    board.sleep(max(0.0, float(times_s[0]) - board.now_s()))
    tumble = collect_until(board, float(times_s[-1]), points=min(points, len(times_s)), progress=tell)
    calibrators = board.identity.calibrators
    names = [name for name in _OURS if name in calibrators] or list(calibrators)
    return tumble, run_calibrators(board, tumble, calibrators=names, n=len(tumble.points), progress=tell)


def _ask_headings(
    board: Board, moments_s: Reals, runs: Mapping[str, CalibratorRun], tell: Progress
) -> list[AverageReply]:
    """Ask for headings and readings at moments of a recording, under existing calibrations."""
    usable = [run for run in runs.values() if run.usable]
    for run in usable:
        board.session.request(SetCalibration(run.slot, run.soft_iron, run.hard_iron))
    mask = sum(1 << run.slot for run in usable)
    replies = []
    for number, moment_s in enumerate(moments_s.tolist()):
        tell("hiltest's firmware", number, len(moments_s))
        board.sleep(max(0.0, moment_s - board.now_s()))
        replies.append(board.session.request(Average(_READINGS, mask)))
    tell("hiltest's firmware", len(moments_s), len(moments_s))
    return replies


def _bias_time_s(motion: MotionRecording) -> float:
    """Return the length of the rest from which the gyroscope's bias is taken, or refuse the recording."""
    rest_s, takes_s = motion.first_motion / motion.rate_hz, len(motion.movement) / motion.rate_hz
    bias_s = min(_LONGEST_BIAS_S, 0.5 * rest_s)
    if rest_s < _SHORTEST_REST_S or takes_s - bias_s > _LONGEST_RUN_S:
        raise ConfigError(
            f"{motion.name}: {takes_s:.0f} s with a rest of {rest_s:.1f} s before the motion; the filter needs a rest "
            f"of {_SHORTEST_REST_S:g} s, and follows {_LONGEST_RUN_S:g} s after half of it: cut the recording"
        )
    return bias_s


def _follow(
    board: Board, motion: MotionRecording, begins_s: float, bias_s: float, tell: Progress
) -> tuple[PlayedAttitude, ...]:
    """Run the filter through a recording."""
    slot = board.identity.slots - 1
    board.session.request(SetCalibration(slot, np.eye(3) / COUNTS_PER_UT, np.zeros(3)))
    board.sleep(max(0.0, begins_s - board.now_s()))
    tell(f"the filter on {motion.name}", 0, 1)
    rest_gyroscope(board, seconds=bias_s, store=True)
    end_s = begins_s + len(motion.movement) / motion.rate_hz - _HELD_S
    summary, records = record_motion(board, lambda: end_s - board.now_s(), slot=slot, longest_s=end_s - board.now_s())
    tell(f"the filter on {motion.name}", 1, 1)
    assert board.stage is not None
    starts_s = 1e-6 * summary.began_us + board.stage.firmware_clock_began_s - begins_s
    times_s: Reals = starts_s + 1e-6 * records.time_us.astype(np.float64)
    truth = motion.truth_at(times_s)
    samples = np.minimum(np.rint(times_s * motion.rate_hz).astype(np.intp), len(motion.movement) - 1)
    masks = {phase: mask[samples] for phase, mask in phases(motion, starts_s).items()}
    sources = {
        FILTER: (records.fused, masks),
        "accelerometer and magnetometer": (records.measured, {"motion": masks["motion"]}),
        "gyroscope": (records.turned, {"motion": masks["motion"]}),
    }
    rows = []
    for name, (attitudes, its_masks) in sources.items():
        exists = np.isfinite(attitudes).all(axis=1)
        errors = attitude_errors(attitudes[exists], truth[exists])
        for phase, mask in its_masks.items():
            if (score := errors.score(mask[exists])) is not None:
                rows.append(
                    PlayedAttitude(
                        name, phase, score.total_deg, score.heading_deg, score.inclination_deg, score.samples
                    )
                )
    return tuple(rows)


def _hiltest_result(run: CalibratorRun, replies: Sequence[AverageReply]) -> PlayedRow:
    cycles = run.cost.cycles if run.cost else None
    if not run.usable:
        return PlayedRow(f"{run.name} ({run.fit.name.lower()})", None, None, None, None, cycles, ())
    attitudes = [reply.headings[run.slot].attitude for reply in replies]
    return PlayedRow(
        run.name,
        tuple((run.hard_iron / COUNTS_PER_UT).tolist()),
        run.result.radius / COUNTS_PER_UT,
        None,
        run.residual_percent,
        cycles,
        tuple(attitude.heading_deg if attitude else None for attitude in attitudes),
    )


def _firmware_results(
    firmware: PlayedRow, belief: Belief, tumble: Tumble, replies: Sequence[AverageReply]
) -> list[PlayedRow]:
    """Return the firmware's own result, and its last calibration applied to the readings of hiltest's firmware."""
    if belief.fit is None:
        return [firmware]
    radius_ut = belief.field_strength_ut
    radius = COUNTS_PER_UT * radius_ut if radius_ut else _mean_norm(belief.fit.corrected(tumble.points))
    unit = replace(belief.fit, soft_iron=belief.fit.soft_iron / radius)
    return [
        firmware,
        PlayedRow(
            CALIBRATED,
            None,
            None,
            None,
            residual_percent(tumble.points, unit),
            None,
            tuple(_heading(reply, unit) for reply in replies),
        ),
    ]


def _mean_norm(vectors: Reals) -> float:
    return float(np.mean(np.linalg.norm(vectors, axis=1)))


def _heading(reply: AverageReply, fit: MagnetometerFit) -> float | None:
    magnetometer, accelerometer = (
        statistic.mean[np.newaxis] for statistic in (reply.magnetometer, reply.accelerometer)
    )
    try:
        return float(headings_deg(magnetometer, accelerometer, fit.soft_iron, fit.hard_iron, NOMINAL)[0])
    except DegenerateFieldError:
        return None
