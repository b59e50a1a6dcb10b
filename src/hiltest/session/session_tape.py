"""The tape of a session: the run's questions to the bench are recorded, or answered from a recording."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import hiltest
from hiltest.errors import ConfigError
from hiltest.rig.rig import other_conditions
from hiltest.rig.rig_file import load_rig, parse_rig
from hiltest.run_record.run import RecordingRecord, utc_now
from hiltest.tape.player import Player
from hiltest.tape.recorded_run import RecordedRun, read_transcript
from hiltest.tape.tape_recorder import Recorder

if TYPE_CHECKING:
    from hiltest.rig import Rig
    from hiltest.session.settings import Settings

_OF_THE_RECORDED_RUN = ("firmware", "base", "port", "seed", "coverage", "record")


class Replay(NamedTuple):
    """A recording, open to be replayed."""

    run: RecordedRun
    player: Player
    record: RecordingRecord

    def settings(self, requested: Settings) -> Settings:
        """Return the settings of the recorded run, except those that are requested.

        Raises
        ------
        ConfigError
            If an option is set that needs a bench.
        """
        for name in _OF_THE_RECORDED_RUN:
            if getattr(requested, name) is not None:
                raise ConfigError(
                    f"{requested.sources[name]} does not go with {requested.sources['replay']}, which has the recorded "
                    "bench, firmware and seed: leave it out"
                )
        run = self.run
        return requested._replace(
            sources={**requested.sources, "rig": requested.sources["rig"] if requested.rig is not None else "recorded"},
            seed=run.seed,
            poses=requested.poses or run.poses,  # type: ignore[arg-type]
            suite=run.suite if requested.sources["suite"] == "default" else requested.suite,  # type: ignore[arg-type]
        )

    def rig(self, named: Path | None) -> Rig:
        """Return the recorded rig, or another one with the same conditions, such as one with other limits.

        Raises
        ------
        ConfigError
            If measurements on the other rig would differ.
        """
        recorded = parse_rig(Path(self.run.rig_file), self.run.rig_text.encode())
        if named is None:
            return recorded
        rig = load_rig(named)
        if different := other_conditions(recorded, rig):
            raise ConfigError(
                f"{named}: not the rig of the recording {self.record.file} ({recorded.path}): {different}. "
                "Leave the option out for the recorded rig"
            )
        return rig


def open_replay(path: Path) -> Replay:
    """Open a recording to be replayed.

    Raises
    ------
    ConfigError
        If the file is no recording.
    """
    if path.is_relative_to(Path.cwd()):  # so that the path is the shortest one
        path = path.relative_to(Path.cwd())
    run, transcript = read_transcript(path)
    return Replay(run, Player(transcript, path), RecordingRecord(str(path), transcript.sha256, run.recorded_utc))


def open_record(path: Path, settings: Settings, rig: Rig, *, holds_limits: bool) -> Recorder:
    """Return the recorder of a run, which writes the file from the first byte to the board on."""
    about = RecordedRun(
        hiltest.__version__,
        utc_now(),
        str(rig.path),
        rig.path.read_text(encoding="utf-8"),
        holds_limits,
        settings.seed,
        settings.poses,
        settings.suite,
    )
    return Recorder(path, asdict(about))
