"""Paths of suites and rigs: in the working tree, or the copy in the package."""

from __future__ import annotations

from pathlib import Path

from hiltest.errors import ConfigError

DEFAULT_RIG = "virtual-k64f.toml"
REAL_RIG = "frdm-k64f.toml"

_PACKAGE = Path(__file__).parents[1]
# The wheel carries the copy as hiltest/bench; an editable checkout has only the repository's hil/.
_SHIPPED = (_PACKAGE / "bench", _PACKAGE.parent.parent / "hil")


def shipped() -> Path:
    """Return the folder with ``suites`` and ``rigs`` that came with this installation.

    Raises
    ------
    ConfigError
        If the installation is incomplete.
    """
    for folder in _SHIPPED:
        if (folder / "suites").is_dir():
            return folder
    raise ConfigError(f"no suites in {' or '.join(map(str, _SHIPPED))}; install hiltest again")


def suites(start: Path) -> Path:
    """Return ``hil/suites`` under `start` if there is one, else the shipped suites."""
    local = start / "hil" / "suites"
    return local if local.is_dir() else shipped() / "suites"


def has_own_rig(start: Path) -> bool:
    """Return whether the default rig is a file under `start`, rather than the shipped one."""
    return (start / "hil" / "rigs" / DEFAULT_RIG).is_file()


def rig_file(start: Path, named: str | None, *, port: str | None = None) -> Path:
    """Return the rig file for a name.

    Parameters
    ----------
    start
        Folder that relative names and ``hil/rigs`` are looked up in.
    named
        A path, or the bare name of a rig in ``hil/rigs``; None for the default rig.
    port
        Port of the board; if it is a real board's, the default rig is ``frdm-k64f``.

    Raises
    ------
    ConfigError
        If the file does not exist; the message lists the existing rigs.
    """
    folders = [start / "hil" / "rigs", shipped() / "rigs"]
    default = DEFAULT_RIG if port is None or port.startswith("hil://") else REAL_RIG
    if named is None:
        candidates = [folder / default for folder in folders]
    else:
        bare = Path(named).name == named
        candidates = [start / named] + [folder / f"{Path(named).stem}.toml" for folder in folders if bare]
    for candidate in candidates:
        if candidate.exists() and not candidate.is_dir():
            return candidate
    rigs = sorted({path.stem for folder in folders for path in folder.glob("*.toml")})
    raise ConfigError(f"no rig file {named or default!r}; rigs here: {', '.join(rigs) or 'none'}")
