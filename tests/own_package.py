"""An installed package with calibrators, found by entry points; one is the example of docs/studies.md."""

from __future__ import annotations

import re
from pathlib import Path

PACKAGE = "spin-sphere"
PAGE = (Path(__file__).parents[1] / "docs" / "studies.md").read_text(encoding="utf-8")
(EXAMPLE,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
(ENTRY_POINT,) = re.findall(r"^```toml\n\[project.*?\n(.*?)\n```", PAGE, re.M | re.S)
MODULE = '''

class Middle:
    """The middle of the range, by a class."""

    def __call__(self, samples):
        return (samples.min(axis=0) + samples.max(axis=0)) / 2.0, 7.0 * np.eye(3)


def never(samples):
    return None


def loud(samples):
    print("iteration 1")
    return samples.mean(axis=0), np.eye(3)


def mirrored(samples):
    return samples.mean(axis=0), -np.eye(3)


def broken(samples):
    raise LookupError("no table")


def endless(samples):
    return samples[0] * np.nan, np.eye(3)


def shapeless(samples):
    return samples[0], 1.0


nothing = 5
'''
NAMES = {
    "middle": "Middle",
    "never": "never",
    "loud": "loud",
    "mirrored": "mirrored",
    "broken": "broken",
    "endless": "endless",
    "direct": "never",
    "shapeless": "shapeless",
}
WRONG = {"absent": "spin_sphere:absent", "unimportable": "spin_nowhere:fit", "nothing": "spin_sphere:nothing"}


def install(folder: Path) -> Path:
    """Write the package into a folder of the search path, as pip would, and return the folder."""
    (folder / "spin_sphere.py").write_text(EXAMPLE + MODULE, encoding="utf-8")
    metadata = folder / "spin_sphere-1.2.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {PACKAGE}\nVersion: 1.2\n", encoding="utf-8")
    places = {name: f"spin_sphere:{place}" for name, place in NAMES.items()} | WRONG
    lines = [ENTRY_POINT.replace('"', ""), *(f"{name} = {place}" for name, place in places.items())]
    table = "\n".join(["[hiltest.calibrators]", *lines, ""])
    (metadata / "entry_points.txt").write_text(table, encoding="utf-8")
    return folder
