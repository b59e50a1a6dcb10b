"""Float64 references of the firmware's calibrators, and the quality of their results."""

from __future__ import annotations

from collections.abc import Callable

from numpy.typing import ArrayLike

from hiltest.calibration.batch import BatchFit
from hiltest.calibration.clouds import Reference
from hiltest.calibration.corrected import fit_corrected
from hiltest.calibration.direct import fit_direct
from hiltest.calibration.fit import Calibrator, FitStatus, MagnetometerFit
from hiltest.calibration.fitzgibbon_ying import fit_fitzgibbon_ying
from hiltest.calibration.frosio import fit_frosio, fit_frosio_centred
from hiltest.calibration.gauss_newton import fit_gauss_newton, fit_gauss_newton_geometric
from hiltest.calibration.geometric import fit_geometric
from hiltest.calibration.gradient_descent import fit_gradient_descent
from hiltest.calibration.hyper import fit_hyper
from hiltest.calibration.iterative import fit_iterative
from hiltest.calibration.levenberg_marquardt import fit_levenberg_marquardt
from hiltest.calibration.li import fit_li
from hiltest.calibration.merayo import fit_merayo
from hiltest.calibration.own import own_calibrator, own_names
from hiltest.calibration.sphere import fit_sphere
from hiltest.calibration.taubin import fit_taubin
from hiltest.errors import ConfigError, nearest_hint

__all__ = [
    "BATCHES",
    "FASTER",
    "FIRMWARE",
    "FOR_COMPARISON",
    "REFERENCES",
    "FitStatus",
    "MagnetometerFit",
    "fit_corrected",
    "fit_direct",
    "fit_iterative",
    "fit_sphere",
    "is_unbiased",
    "reference",
]

# References by the firmware's names, or for calibrators that it lacks by those of the literature.
REFERENCES: dict[str, Calibrator] = {
    "direct": fit_direct,
    "direct-fast": fit_direct,
    "corrected": fit_corrected,
    "iterative": fit_iterative,
    "inverse-iteration": fit_iterative,
    "li": fit_li,
    "fitzgibbon-ying": fit_fitzgibbon_ying,
    "merayo": fit_merayo,
    "taubin": fit_taubin,
    "hyper": fit_hyper,
    "gradient-descent": fit_gradient_descent,
    "frosio": fit_frosio,
    "frosio-centred": fit_frosio_centred,
    "gauss-newton": fit_gauss_newton,
    "gauss-newton-geometric": fit_gauss_newton_geometric,
    "levenberg-marquardt": fit_levenberg_marquardt,
    "geometric": fit_geometric,
}
# References that fit many instances at once, along leading axes, in space or in a plane.
BATCHES: dict[str, Callable[[ArrayLike], BatchFit]] = {
    name: entry.batch for name, entry in REFERENCES.items() if isinstance(entry, Reference)
}
# Calibrators of the packaged firmware.
FIRMWARE = frozenset({"direct", "direct-fast", "corrected", "iterative"})
# Calibrators of the firmware for comparison only: in the full set of tests, and in fits on request.
FOR_COMPARISON = frozenset({"inverse-iteration", "li", "gauss-newton", "gradient-descent"})
FIRMWARE |= FOR_COMPARISON
# Calibrators that only differ in the computation of sums or of eigenvectors: in float64 they equal another one.
FASTER = frozenset({"direct-fast", "inverse-iteration"})
# Calibrators with no or almost no noise bias.
_UNBIASED = frozenset({"corrected", "gauss-newton-geometric", "geometric", "hyper", "taubin"})


def reference(name: str) -> Calibrator:
    """Return the float64 reference of a calibrator, or the calibrator of an installed package.

    Raises
    ------
    ConfigError
        When there is none by that name; a user's calibrators can run without one.
    """
    calibrator = REFERENCES.get(name) or own_calibrator(name)
    if calibrator is None:
        hint = nearest_hint(name, [*REFERENCES, *own_names()], "those that have")
        raise ConfigError(f"calibrator {name!r} has no float64 reference; {hint}")
    return calibrator


def is_unbiased(name: str, iterations: int) -> bool:
    """Return whether a calibrator's fit has no noise bias; `corrected` without a step has another one's bias."""
    return name in _UNBIASED and (name != "corrected" or iterations > 0)
