"""What the header of a recording says of the run: enough to begin it again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hiltest.errors import ConfigError
from hiltest.link.transcript import Transcript
from hiltest.replay.values import restored


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """A recorded run."""

    hiltest: str
    """Version that recorded it."""
    recorded_utc: str
    rig_file: str
    rig_text: str
    """The rig's file: its name, and what it held."""
    holds_limits: bool
    """Whether a limit of the rig that nothing was measured against failed the run."""
    seed: int | None
    """Seed that the command line gave."""
    poses: str | None
    """Poses that it gave."""
    suite: str


def read_transcript(path: Path) -> tuple[RecordedRun, Transcript]:
    """Read a recording: the run, and the transcript.

    Raises
    ------
    ConfigError
        When the file is no transcript, or one of no run.
    """
    transcript = Transcript.read(path)
    if transcript.recorded is None:
        raise ConfigError(f"{path}: a wire trace, not a recording of a run: make one with --hil-record FILE")
    try:
        run: RecordedRun = restored(RecordedRun, transcript.recorded)
    except ValueError as error:
        raise ConfigError(f"{path}:1: not the header of a recorded run: {error}; record it again") from None
    return run, transcript
