"""Description of a run in the header of its recording, sufficient to repeat it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from hiltest.errors import ConfigError
from hiltest.link.transcript import Transcript
from hiltest.tape.values import restored


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """A recorded run."""

    hiltest: str
    """Version of hiltest that recorded it."""
    recorded_utc: str
    rig_file: str
    rig_text: str
    """Name and contents of the rig's file."""
    holds_limits: bool
    """True if an unmeasured limit of the rig failed the run."""
    seed: int | None
    """Seed from the command line."""
    poses: str | None
    """Poses from the command line."""
    suite: str


def read_transcript(path: Path) -> tuple[RecordedRun, Transcript]:
    """Read a recording: the run, and the transcript.

    Raises
    ------
    ConfigError
        When the file is not a transcript, or not of a recorded run.
    """
    transcript = Transcript.read(path)
    if transcript.recorded is None:
        raise ConfigError(
            f"{path} is a wire trace, not a recording of a run: make a recording with hiltest run --record FILE"
        )
    try:
        run: RecordedRun = restored(RecordedRun, transcript.recorded)
    except ValueError as error:
        raise ConfigError(f"{path}:1: not the header of a recorded run: {error}; record it again") from None
    if not run.rig_file.isprintable() or ".." in PureWindowsPath(run.rig_file).parts:
        raise ConfigError(f"{path}:1: {run.rig_file!r} leads elsewhere, and cannot name a rig; record it again")
    return run, transcript
