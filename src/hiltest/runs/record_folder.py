"""The folder that a session keeps its record in."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from hiltest.settings import make_folder

if TYPE_CHECKING:
    from hiltest.report.recorder import Recorder
    from hiltest.rig import Rig
    from hiltest.settings import Settings


class RecordFolder:
    """A folder that belongs to one session alone from `claim` to `release`.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._recorder: Recorder | None = None
        self._made = False

    def claim(self, settings: Settings, rig: Rig | None) -> Recorder:
        """Return what keeps the record; from the first call on the record that `hiltest report` finds is this one.

        Raises
        ------
        ConfigError
            If another run has the folder, or it cannot be written to.
        """
        from hiltest.report.journal import Journal
        from hiltest.report.recorder import Recorder
        from hiltest.report.revision import revision_of

        if self._recorder is None:
            self._made = not self.path.exists()
            make_folder(self.path)
            poses = settings.poses or (rig.procedure.poses if rig else "all")
            self._recorder = Recorder(
                Journal(self.path), suite=settings.suite, poses=poses, revision=revision_of(settings.label)
            )
        return self._recorder

    def release(self) -> None:
        """Give the folder back, when every file of the run is written."""
        if self._recorder is not None:
            self._recorder.release()
        if self._made:
            with suppress(OSError):  # a usage error leaves nothing in it, and a run does
                self.path.rmdir()
