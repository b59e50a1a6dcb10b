"""Float64 references of the firmware's calibrators, and what their results are worth."""

from __future__ import annotations

from hiltest.calibration.corrected import fit_corrected
from hiltest.calibration.direct import fit_direct
from hiltest.calibration.fit import Calibrator, FitStatus, MagnetometerFit
from hiltest.calibration.iterative import fit_iterative
from hiltest.calibration.sphere import fit_sphere
from hiltest.errors import ConfigError

__all__ = [
    "FASTER", "REFERENCES", "FitStatus", "MagnetometerFit", "fit_corrected", "fit_direct", "fit_iterative",
    "fit_sphere", "is_unbiased", "reference",
]  # fmt: skip

# By the firmware's names.
REFERENCES: dict[str, Calibrator] = {
    "direct": fit_direct, "direct-fast": fit_direct, "corrected": fit_corrected, "iterative": fit_iterative,
}  # fmt: skip
# Those that only come to their sums in another way: in float64 they are another's fit.
FASTER = frozenset({"direct-fast"})
_UNBIASED = frozenset({"corrected"})


def is_unbiased(name: str, iterations: int) -> bool:
    """Say whether a calibrator took the bias of noise out: its steps do, and with no step its fit is another's."""
    return name in _UNBIASED and iterations > 0


def reference(name: str) -> Calibrator:
    """Return the float64 reference of a calibrator.

    Raises
    ------
    ConfigError
        When there is none by that name; calibrators of one's own need none to be run.
    """
    try:
        return REFERENCES[name]
    except KeyError:
        known = ", ".join(sorted(REFERENCES))
        raise ConfigError(f"calibrator {name!r} has no float64 reference; those that have: {known}") from None
