"""Steps of an operator, written to the journal at once, so that a run that was stopped or killed can be continued."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hiltest.boards import Board
from hiltest.calibration.still_pose import StillPose
from hiltest.link.replies import AverageReply
from hiltest.procedures import Achieved, Tumble
from hiltest.procedures.cycles import upload_pairs
from hiltest.run_record.recorder import Recorder
from hiltest.tape.values import plain, restored
from hiltest.text import format_count, join_words

KIND = "by hand"
"""Kind of these entries in the journal."""
_NAMED_AT_MOST = 3


class ByHand:
    """The steps of an operator that a run need not repeat, including those of the previous run.

    Parameters
    ----------
    recorder
        Recorder of this run, whose folder may hold the journal of one that was cut short.
    bench
        Properties, by name, that must be equal for this run to use the steps of another one.
    refuse
        Returns why a tumble does not suffice; that of another run is then not used.

    Attributes
    ----------
    remark : str
        Description of the steps that were taken over, or the reason why none were; empty without an earlier run.
    """

    def __init__(
        self, recorder: Recorder, bench: Mapping[str, str], refuse: Callable[[Tumble], str] = lambda tumble: ""
    ) -> None:
        self._recorder, self._refuse = recorder, refuse
        self._since, entries = recorder.earlier(KIND)
        self._poses: dict[int, tuple[Achieved, AverageReply]] = {}
        self._tumble: Tumble | None = None
        self._faces: tuple[list[StillPose], int] = [], 0
        self._held: Mapping[str, Any] = {}
        self._bench = dict(bench)
        self._begun = False
        self.remark = self._take_over(entries) if entries else ""

    def tumble(self, board: Board, collect: Callable[[], Tumble]) -> Tumble:
        """Return the tumble of the previous run, after uploading its points, or else collect one."""
        if self._tumble is not None:
            upload_pairs(board, self._tumble.points, self._tumble.accelerometer)
            return self._tumble
        tumble = collect()
        self._keep(tumble=plain(tumble))
        return tumble

    def faces(self) -> tuple[list[StillPose], int]:
        """Return the faces that the previous run measured, and the die's temperature at the last of them [degC]."""
        return self._faces

    def keep_faces(self, faces: Sequence[StillPose], die_temperature_degc: int) -> None:
        """Write the six faces through to the disk, unless they are there already."""
        if not self._faces[0]:
            self._keep(degc=die_temperature_degc, faces=plain(faces))

    def earlier(self, held: Mapping[str, Sequence[float]]) -> tuple[dict[int, tuple[Achieved, AverageReply]], str]:
        """Return the known angles that the previous run measured with the same calibrations, and a remark.

        Parameters
        ----------
        held
            All numbers of each calibration that the board holds now.
        """
        now = {name: list(numbers) for name, numbers in held.items()}
        others = sorted(name for name in now.keys() | self._held.keys() if now.get(name) != self._held.get(name))
        if self._poses and not others:
            count = format_count(len(self._poses), "known angle")
            return self._poses, f"{count} of the run of {self._since}, taken over.\n"
        self._keep(held=now)
        return {}, "" if not self._poses else (
            f"The known angles begin anew: the calibration {join_words(others, _NAMED_AT_MOST)} is another than in the "
            f"run of {self._since}.\n"
        )

    def keep(self, index: int, measured: tuple[Achieved, AverageReply]) -> None:
        """Write a known angle through to the disk."""
        achieved, answer = measured
        self._keep(pose=index, there=plain(achieved), answer=plain(answer))

    def _keep(self, **content: object) -> None:
        if not self._begun:
            self._recorder.keep(KIND, {"bench": self._bench})
            self._begun = True
        self._recorder.keep(KIND, content)

    def _take_over(self, entries: Sequence[Mapping[str, Any]]) -> str:
        run = f"the run of {self._since}, which was cut short"
        before = entries[0].get("bench")
        if not isinstance(before, dict):
            return f"begins anew: the journal of {run}, is damaged"
        others = [name for name, now in self._bench.items() if before.get(name) != now]
        if others:
            return f"begins anew, and does not go on with {run}: another {join_words(others, _NAMED_AT_MOST)}"
        try:
            for entry in entries[1:]:
                self._restore(entry)
        except (LookupError, TypeError, ValueError):
            self._tumble, self._faces, self._poses, self._held = None, ([], 0), {}, {}
            return f"begins anew: the journal of {run}, is damaged"
        steps = [
            *(["the six faces"] if self._faces[0] else []),
            *(["the tumble"] if self._tumble else []),
            *([format_count(len(self._poses), "known angle")] if self._poses else []),
        ]
        refused = self._refuse(self._tumble) if self._tumble else ""
        if refused:  # its calibrations and poses go with it
            self._tumble, self._poses, self._held = None, {}, {}
            entries = [entry for entry in entries if "faces" in entry or "bench" in entry]
            steps = [step for step in steps if step == "the six faces"]
        for entry in entries[1:]:  # written again, since this run may be stopped before it reaches them
            self._keep(**{name: value for name, value in entry.items() if name != "kind"})
        anew = f"the tumble begins anew: {refused}" if refused else ""
        return "; ".join(filter(None, (f"goes on with {run}: {', '.join(steps)} taken over" if steps else "", anew)))

    def _restore(self, entry: Mapping[str, Any]) -> None:
        if "tumble" in entry:
            tumble: Tumble = restored(Tumble, entry["tumble"])
            if not tumble.points.shape == tumble.accelerometer.shape == (len(tumble.taken), 3):
                raise ValueError("a tumble of other shapes")
            self._tumble = tumble
        elif "faces" in entry:
            faces: list[StillPose] = restored(list[StillPose], entry["faces"])
            _require_axes(mean for face in faces for mean in (face.magnetometer, face.accelerometer))
            self._faces = faces, int(entry["degc"])
        elif "held" in entry:
            self._held, self._poses = dict(entry["held"]), {}
        elif "pose" in entry:
            answer: AverageReply = restored(AverageReply, entry["answer"])
            _require_axes((answer.magnetometer.mean, answer.accelerometer.mean))
            self._poses[int(entry["pose"])] = restored(Achieved, entry["there"]), answer


def _require_axes(means: Iterable[NDArray[np.float64]]) -> None:
    if any(mean.shape != (3,) for mean in means):
        raise ValueError("a mean of other than three axes")
