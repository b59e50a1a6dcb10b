"""Write src/hiltest/measurement/deviations.py anew: ``python docs/deviations.py GATE.json FULL.json``.

Both are baselines of the shipped firmware on the default rig over many seeds, the second of the full set of tests:
``tox -e deviations`` makes them. What the gate set measures too is taken from the first, which has more seeds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from statistics import stdev

from hiltest.measurement import identify, is_compared
from hiltest.verdict.baseline import Baseline, BaselineRow
from hiltest.verdict.baseline_file import read_baseline

FILE = Path(__file__).parents[1] / "src" / "hiltest" / "measurement" / "deviations.py"

TEXT = '''\
"""Standard deviations of measurements over seeds of the default rig, with the packaged firmware.

Written by ``tox -e deviations``: the first table over {gate} seeds of the gate set, the second over {full} of the
full one. On a real board, until it has said itself how much its runs differ, they stand for its noise.
"""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.measurement.kind import Deviation

_GATE: dict[str, float] = {{
{of_gate}
}}

_FULL: dict[str, float] = {{
{of_full}
}}

DEVIATIONS: Mapping[str, Deviation] = {{
    **{{name: Deviation(value, {gate_freedom}) for name, value in _GATE.items()}},
    **{{name: Deviation(value, {full_freedom}) for name, value in _FULL.items()}},
}}
"""By exact name. Kinds that no seed moves are not here; 0 stands where seeds move others of the kind."""
'''


def main(gate: Baseline, full: Baseline) -> str:
    """Return the text of the module."""
    of_gate = {row.name: _deviation(row) for row in gate.measurements if is_compared(row.name)}
    of_full = {row.name: _deviation(row) for row in full.measurements if is_compared(row.name)}
    moved = {_kind(name) for name, value in {**of_full, **of_gate}.items() if value}
    return TEXT.format(
        gate=len(gate.seeds), full=len(full.seeds), gate_freedom=len(gate.seeds) - 1, full_freedom=len(full.seeds) - 1,
        of_gate=_lines({name: value for name, value in of_gate.items() if _kind(name) in moved}),
        of_full=_lines({
            name: value for name, value in of_full.items() if name not in of_gate and _kind(name) in moved
        }),
    )  # fmt: skip


def _kind(name: str) -> str:
    kind = identify(name).kind
    return kind.name if kind else name


def _deviation(row: BaselineRow) -> float:
    values = [float(value) for value in row.values if value is not None]
    return float(f"{stdev(values):.3g}") if len(values) == len(row.values) and max(values) > min(values) else 0.0


def _lines(found: dict[str, float]) -> str:
    return "\n".join(f'    "{name}": {value:g},' for name, value in sorted(found.items()))


if __name__ == "__main__":
    FILE.write_text(main(*(read_baseline(Path(name)) for name in sys.argv[1:])), encoding="utf-8")
