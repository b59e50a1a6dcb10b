"""Compare two sides: every measurement's change, and what keeps the gate from being evaluated."""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.comparison.difference import Pairs, difference
from hiltest.comparison.evidence import Evidence, Seed
from hiltest.comparison.model import Comparison, Difference, Side, Tolerance
from hiltest.comparison.obstacles import obstacles
from hiltest.comparison.words import sentence
from hiltest.measurement import Measurement


def compare(
    base: Evidence, new: Evidence, *, together: bool = False, tolerances: Mapping[str, Tolerance] | None = None
) -> Comparison:
    """Compare two sides, paired by seed.

    Parameters
    ----------
    base, new : Evidence
    together : bool, optional
        Whether both firmwares ran in one session: they may then be of different compilers and flags.
    tolerances : mapping of str to Tolerance, optional
        By exact name, instead of those of the new side's rig.

    Returns
    -------
    Comparison
        With obstacles where the gate cannot be evaluated; the differences are then for information alone.
    """
    given = new.tolerances if tolerances is None else tolerances
    board = new.conditions.board if new.conditions else ""
    seeds = [seed for seed in base.measurements if seed in new.measurements]
    found = tuple(difference(pairs, board, given) for pairs in _pairs(base, new, seeds))
    return _comparison(base.side, new.side, found, obstacles(base, new, found, together=together))


def not_compared(file: str, reason: str, new: Evidence) -> Comparison:
    """Return the comparison with a base that cannot be read: nothing but the obstacle.

    Parameters
    ----------
    file : str
        That was to be the base.
    reason : str
        Why it is none, with what to do.
    new : Evidence
    """
    base = Side(
        file=file, sha256="", firmware="", version="", build_id="", compiler="", cycle_model="", rig="", seeds=(),
        saved_utc="",
    )
    return _comparison(base, new.side, (), (reason, *new.faults))


def _comparison(base: Side, new: Side, found: tuple[Difference, ...], reasons: tuple[str, ...]) -> Comparison:
    return Comparison(base, new, found, reasons, sentence(found, reasons))


def _pairs(base: Evidence, new: Evidence, seeds: list[Seed]) -> list[Pairs]:
    """Return what is compared, by name: all but what is volatile in the base, or new and volatile."""
    names: set[str] = set()
    for seed in seeds:
        names.update(name for name, each in base.measurements[seed].items() if not each.volatile)
        was = base.measurements[seed]
        names.update(name for name, each in new.measurements[seed].items() if not each.volatile and name not in was)
    return [
        Pairs(name, _on(base.measurements, name, seeds), _on(new.measurements, name, seeds)) for name in sorted(names)
    ]


def _on(
    measurements: Mapping[Seed, Mapping[str, Measurement]], name: str, seeds: list[Seed]
) -> dict[Seed, Measurement | None]:
    return {seed: measurements[seed].get(name) for seed in seeds}
