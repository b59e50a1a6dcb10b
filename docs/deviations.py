"""Write src/hiltest/measurement/deviations.py anew: ``python docs/deviations.py hil/baselines/seeds-1-100.json``.

The file is a baseline of the shipped firmware on the default rig over many seeds of the full set: ``tox -e campaign``.
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

Written by ``tox -e campaign``, over {seeds} seeds of the full set of tests. On a real board, until it has said itself
how much its runs differ, they stand for its noise.
"""

from __future__ import annotations

from collections.abc import Mapping

from hiltest.measurement.kind import Deviation

_VALUES: dict[str, float] = {{
{values}
}}

DEVIATIONS: Mapping[str, Deviation] = {{name: Deviation(value, {freedom}) for name, value in _VALUES.items()}}
"""By exact name. Kinds that no seed moves are not here; 0 stands where seeds move others of the kind."""
'''


def main(baseline: Baseline) -> str:
    """Return the text of the module."""
    found = {row.name: _deviation(row) for row in baseline.measurements if is_compared(row.name)}
    moved = {_kind(name) for name, value in found.items() if value}
    return TEXT.format(
        seeds=len(baseline.seeds),
        freedom=len(baseline.seeds) - 1,
        values=_lines({name: value for name, value in found.items() if _kind(name) in moved}),
    )


def _kind(name: str) -> str:
    kind = identify(name).kind
    return kind.name if kind else name


def _deviation(row: BaselineRow) -> float:
    values = [float(value) for value in row.values if value is not None]
    return float(f"{stdev(values):.3g}") if len(values) == len(row.values) and max(values) > min(values) else 0.0


def _lines(found: dict[str, float]) -> str:
    return "\n".join(f'    "{name}": {value:g},' for name, value in sorted(found.items()))


if __name__ == "__main__":
    FILE.write_text(main(read_baseline(Path(sys.argv[1]))), encoding="utf-8")
