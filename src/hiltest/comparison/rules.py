"""Which way each measurement gets better, and how far it moves when nothing got worse.

One table, with the reason of each row. The paired figures were measured on the default rig over seeds 1 to 8 (the full
set: 1 to 4), with the packaged firmware against itself compiled otherwise: ``-O3`` (other times, the same rounding),
``-fassociative-math`` and ``-ffp-contract=fast`` (sums in another order, multiply-adds rounded once). On a virtual
board noise is a function of seed and sample, so what such a firmware moves is all that a harmless change can.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache

from hiltest.comparison.model import EXACT, Sense, Tolerance
from hiltest.measurement import Limit, Measurement

NOT_COMPARED = "board.*_seconds"
"""How long a run took says nothing of the firmware, and depends on which tests ran."""

#: Two runs that do not share their noise differ by sqrt(2) standard deviations of one; six of one, 4.2 of the
#: difference, are passed by 3 in 100 000 of them, and a run has a hundred measurements.
UNPAIRED_DEVIATIONS = 6.0


@dataclass(frozen=True, slots=True)
class Rule:
    """How measurements of one kind are compared.

    Attributes
    ----------
    tolerance : Tolerance
        On a board that repeats itself.
    deviation : float
        Standard deviation over seeds 1 to 8 of the default rig: how far noise alone moves it.
    reason : str
        Of the tolerance.
    """

    sense: Sense
    tolerance: Tolerance
    deviation: float
    reason: str

    def tolerance_on(self, board: str) -> Tolerance:
        """Return the tolerance for a kind of board: each run of a real one has noise of its own."""
        if board != "real":
            return self.tolerance
        absolute = max(self.tolerance.absolute, UNPAIRED_DEVIATIONS * self.deviation)
        return Tolerance(absolute, self.tolerance.relative)


_LESS, _MORE, _ZERO, _FACT = Sense.SMALLER, Sense.LARGER, Sense.NEARER_ZERO, Sense.NEITHER
_COUNTED = "counted, not measured"
_KERNEL = "virtual cycles of one call are the same on every machine: one more is one more"
_PER_CALL = "of calls whose number depends on the data; half a percent is less than one instruction in a loop of 100"
_LINE = "slope or intercept of a line through few sizes; one instruction a point is 1 % of the cheapest calibrator"
_ROUNDING = "float32 in another order moved it by less than a hundredth of this"
_MOTION = "sampled in motion, at times that any other firmware shifts by microseconds"
_OF_PART = "of the simulated parts or of the rig: no firmware should move it"

_WORST_SECTOR = "heading.*.worst_sector"

# The first row with a pattern that fits wins; `*` stands for anything.
_ROWS: tuple[tuple[str, Sense, float, float, float, str], ...] = (
    # patterns                         better  absolute relative deviation  reason
    ("cycles.*.total",                  _LESS, 0, 0, 0, _KERNEL),
    ("cycles.fusion.*.mean",            _LESS, 0.5, 0.005, 0, _PER_CALL),
    ("cycles.fusion.predict cycles.fusion.update", _LESS, 0, 0, 0, _KERNEL),
    ("cycles.*.store_per_point",        _LESS, 0, 0, 0, _KERNEL),
    ("cycles.*.float64_distance",       _LESS, 5e-4, 0, 0, "of golden clouds; as heading.*.float32_error"),
    ("cycles.*.per_point",              _LESS, 0.5, 0.005, 0, _LINE),
    ("cycles.*.per_iteration",          _LESS, 0.5, 0.005, 0, _LINE),
    ("cycles.*.fixed",                  _LESS, 5, 0.01, 0, _LINE),
    ("cycles.*.regression_residual",   _FACT, 1, 0.05, 0, "how well the line describes the calls, not what they cost"),
    ("cycles.*.spread",                 _LESS, 5, 0.05, 0, "between the cheapest and the dearest of some clouds"),
    ("cycles.*.sweeps",                _FACT, 0, 0, 0, _COUNTED + "; what they cost is in the total"),
    ("cycles.*.instructions*",         _FACT, 0, 0.01, 0, "what they cost is in the total"),
    ("*.cycles",                        _LESS, 0, 0, 0, _KERNEL),
    ("stream.*.fit_cycles",             _LESS, 0, 0, 0, _KERNEL),
    ("stream.*.cycles_max",             _LESS, 5, 0.005, 3700, _PER_CALL),
    ("stream.*.cycles_me*",              _LESS, 1, 0.005, 210, _PER_CALL),
    ("stream.*.total",                  _LESS, 300, 0.005, 63_000, _PER_CALL),
    ("stream.*.remove_max stream.*.remove_mean", _LESS, 0, 0, 0, _KERNEL),
    ("stream.*.elements",               _MORE, 0, 0, 0, _COUNTED),
    ("stream.*.refused",                _LESS, 0, 0, 0, _COUNTED),
    ("stream.*.held",                  _FACT, 0, 0, 2, _COUNTED),

    ("heading.dpi.float32_error",       _LESS, 5e-4, 0, 4.2e-5, "moved by 1.2e-4; " + _MOTION),
    ("heading.*.float32_error",         _LESS, 5e-4, 0, 1.8e-5, "moved by 3.3e-5; a wrong kernel differs by far more"),
    (_WORST_SECTOR,                    _FACT, 0, 0, 145, "which of the sectors: no quantity"),
    ("heading.uncalibrated.max heading.uncalibrated.max_level", _FACT, 0.01, 0, 0.25, _OF_PART),
    ("heading.dpi.tilt_sensitivity",    _ZERO, 0.05, 0.05, 0.10, "moved by 0.015; " + _MOTION),
    ("heading.*.tilt_sensitivity",      _ZERO, 0.01, 0.01, 0.10, _ROUNDING),
    ("heading.dpi.bias",                _ZERO, 0.05, 0.05, 0.14, "moved by 0.003; " + _MOTION),
    ("heading.*.bias",                  _ZERO, 0.01, 0.01, 0.041, _ROUNDING),
    ("heading.dpi.max* heading.dpi.rms", _LESS, 0.1, 0.05, 0.33, "moved by 0.040; " + _MOTION),
    ("heading.*.max heading.*.max_centred heading.*.rms", _LESS, 0.01, 0.01, 0.38, _ROUNDING),

    ("fit.*.status",                    _LESS, 0, 0, 0, "0 is the fit that was asked for, all others are less"),
    ("fit.*.n_used",                    _MORE, 0, 0, 0, _COUNTED),
    ("fit.*_declared",                 _FACT, 0, 0, 0, _OF_PART),
    ("fit.*.residual_predicted",       _FACT, 1e-4, 0, 0, _OF_PART),
    ("fit.dpi.coverage",                _LESS, 0.05, 0.02, 0.07, "moved by 0.012; " + _MOTION),
    ("fit.*.coverage",                  _LESS, 0.01, 0.01, 0.05, _ROUNDING),
    ("fit.*.dip",                      _FACT, 0.02, 0, 0.041, "moved by 0.005; " + _MOTION),
    ("fit.*.strength",                 _FACT, 0.02, 0, 0.026, "moved by 0.002; " + _MOTION),
    ("fit.dpi.offset_error",            _LESS, 0.02, 0.05, 0.032, "moved by 0.005; " + _MOTION),
    ("fit.*.offset_error",              _LESS, 0.005, 0.01, 0.057, _ROUNDING),
    ("fit.dpi.rotation_left",           _LESS, 0.05, 0.05, 0.052, "moved by 0.020; " + _MOTION),
    ("fit.*.rotation_left",             _LESS, 0.005, 0.01, 0.054, _ROUNDING),
    ("fit.*.standard_error",            _LESS, 0.02, 0.02, 0.054, "moved by 0.005; " + _MOTION),
    ("fit.*.residual",                  _LESS, 0.005, 0.005, 0.076, "moved by 0.0007; " + _MOTION),

    ("accelerometer.untrimmed_norm_rms", _FACT, 0.01, 0.01, 0.046, _OF_PART),
    ("accelerometer.rest_norm_error",  _FACT, 0.01, 0.01, 0.12, _OF_PART),
    ("accelerometer.*axis_error accelerometer.*offset_error *.tilt_error", _LESS, 0.005, 0.01, 0.084, _ROUNDING),
    ("accelerometer.*norm_rms accelerometer.*.residual", _LESS, 0.01, 0.01, 0.064, _ROUNDING),
    ("magnetometer.*.norm_rms",         _LESS, 0.005, 0.01, 0.076, _ROUNDING),

    ("gyroscope.temperature",          _FACT, 1, 0, 1, "the part gives whole degrees"),
    ("gyroscope.uncorrected_error",    _FACT, 0.01, 0, 0.006, _OF_PART),
    ("gyroscope.sensitivity_error*",   _FACT, 0.02, 0, 0.015, "moved by 0.008; " + _MOTION),
    ("gyroscope.scale_error*",          _ZERO, 0.02, 0.02, 0.015, "moved by 0.008; " + _MOTION),
    ("gyroscope.noise_density",        _FACT, 0.5, 0.02, 0.5, "moved by 0.15; " + _MOTION),
    ("gyroscope.*bias_error",           _LESS, 0.001, 0.01, 0.003, _ROUNDING),
    ("gyroscope.*turn_error",           _LESS, 0.05, 0.02, 0.033, "moved by 0.020; " + _MOTION),
    ("gyroscope.misalignment* gyroscope.scale_uncertainty", _LESS, 0.005, 0.02, 0.007, _ROUNDING),

    ("fusion.left_out",                 _LESS, 0, 0, 0, _COUNTED),
    ("fusion.corrections",             _FACT, 0, 0, 0, _COUNTED),
    ("fusion.accelerometer_magnetometer.heading.max", _LESS, 0.5, 0.05, 0.17, "moved by 0.27; " + _MOTION),
    ("fusion.*heading.max fusion.*heading.rms fusion.*tilt.rms", _LESS, 0.15, 0.02, 0.38, "moved by 0.078; " + _MOTION),

    ("budget.*.effort",                 _MORE, 0, 0, 5.2, "what the budget buys: follows from exact cycles"),
    ("budget.*.mean_error",             _LESS, 0.25, 0.02, 0.38, "moved by 0.14, by one point more of 16"),

    ("link.echoed",                     _MORE, 0, 0, 0, _COUNTED),
    ("link.damaged_answered link.damaged_uncounted link.retried link.uart_overruns", _LESS, 0, 0, 0, _COUNTED),
    ("identity.calibrators identity.core_clock", _FACT, 0, 0, 0, _COUNTED),
    ("tumble.points",                   _MORE, 0, 0, 0, _COUNTED),
    ("tumble.coverage",                 _MORE, 0.5, 0.01, 0.2, "half a percent is a sixth of one of 300 directions"),
    ("board.virtual_seconds",          _FACT, 5, 0.02, 1, "waiting, not work; moved by 4.4 of 239 in the full set"),
)  # fmt: skip


def rule_of(name: str, limit: Limit | None) -> Rule:
    """Return how a measurement is compared.

    Parameters
    ----------
    name : str
    limit : Limit or None
        Says which way a measurement of one's own gets better; it is compared exactly unless the rig says otherwise.
    """
    return _known_rule(name) or Rule(_sense_under(limit), EXACT, 0.0, "not one of hiltest's own: any change counts")


def is_compared(name: str) -> bool:
    """Say whether a measurement is one that a comparison looks at."""
    return not fnmatchcase(name, NOT_COMPARED)


def is_direction(name: str) -> bool:
    """Say whether a measurement is a direction [deg]: 330 and 30 are 60 apart, and none is a share of another."""
    return fnmatchcase(name, _WORST_SECTOR)


def is_known(name: str) -> bool:
    """Say whether the table has a row for a name."""
    return _known_rule(name) is not None


def tolerance_of(name: str, rule: Rule, board: str, of_rig: Mapping[str, Tolerance]) -> Tolerance:
    """Return the tolerance of a measurement: the rig's, or else the rule's for this kind of board."""
    return of_rig.get(name) or rule.tolerance_on(board)


def tolerances_in_force(
    measurements: Iterable[Measurement], board: str, of_rig: Mapping[str, Tolerance]
) -> dict[str, Tolerance]:
    """Return what every measurement that is compared is held to, by name."""
    return {
        each.name: tolerance_of(each.name, rule_of(each.name, each.limit), board, of_rig)
        for each in measurements if is_compared(each.name) and not each.volatile
    }


@cache
def _known_rule(name: str) -> Rule | None:
    for patterns, sense, absolute, relative, deviation, reason in _ROWS:
        if any(fnmatchcase(name, each) for each in patterns.split()):
            return Rule(sense, Tolerance(absolute, relative), deviation, reason)
    return None


def _sense_under(limit: Limit | None) -> Sense:
    """Return the sense that a limit implies: away from a one-sided one, towards the middle of a symmetric one."""
    if limit is None:
        return Sense.NEITHER
    if limit.min is None:
        return Sense.SMALLER
    if limit.max is None:
        return Sense.LARGER
    return Sense.NEARER_ZERO if limit.min == -limit.max else Sense.NEITHER
