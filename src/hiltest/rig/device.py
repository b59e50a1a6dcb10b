"""The ``[device]`` table of a rig: interface to firmware without hiltest's protocol."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from hiltest.rig.memory_device import MemoryDevice
from hiltest.rig.text_device import TextDevice
from hiltest.rig.toml_tables import StrictTable, require

#: Conventions of the firmware's axes and heading: see docs/compass.md.
FrameName = Literal["ned", "enu", "android", "windows"]


@dataclass(frozen=True, slots=True)
class FsflkDevice(StrictTable):
    """Packets of NXP's sensor fusion."""

    release: Literal["4.22", "5.00", "7"] = "7"
    """Release of the packets."""
    algorithm: str = ""
    """Command of the Sensor Fusion Toolbox that is sent at the start, such as ``"Q9"``; empty for none."""


@dataclass(frozen=True, slots=True)
class Device(StrictTable):
    """Interface to the firmware under test, and its waiting times."""

    kind: str | tuple[str, ...]
    """One kind, or several kinds that each give some quantities: ``hiltest``, ``fsflk``, ``text``, ``memory``, or the
    name of a user's entry point."""
    frame: FrameName = "ned"
    """Convention of the firmware's axes and angles."""
    heading: Literal["clockwise", "counterclockwise"] | None = None
    """Direction in which its heading increases, seen from above; by default the frame's."""
    start_s: float = 1.0
    """Time from power-on until the firmware's first output."""
    converge_s: float = 0.0
    """Time that the board rests level before and after the tumble, in which a filter finds the gyroscope's offset."""
    tumbles: int = 1
    tumble_s: float = 20.0
    """Number of tumbles, and the duration of each."""
    window_s: float = 1.0
    """Length of a window: the heading is settled if two consecutive windows agree in their mean."""
    settle_s: float = 10.0
    """Longest wait for a settled heading at each pose."""
    sources: dict[str, str] = field(default_factory=dict)
    """Kind that gives a quantity, by the quantity's name, if there are several kinds. The default is the first kind
    that offers it."""
    fsflk: FsflkDevice = field(default_factory=FsflkDevice)
    """Table of the kind ``fsflk``."""
    text: TextDevice | None = None
    memory: MemoryDevice | None = None
    """Tables of the kinds with these names."""
    options: dict[str, Any] = field(default_factory=dict)
    """Table of a user's kind."""

    def __post_init__(self) -> None:
        require(bool(self.kinds), "kind", 'has no kind; write kind = "fsflk" or another')
        require(
            "hiltest" not in self.kinds or self.kinds == ("hiltest",),
            "kind",
            '"hiltest" excludes other kinds: firmware that speaks its protocol offers all by that',
        )
        for kind, table, says in (
            ("text", self.text, "the meaning of its lines"),
            ("memory", self.memory, "its variables"),
        ):
            require(
                kind not in self.kinds or table is not None,
                "kind",
                f'"{kind}" needs a table [device.{kind}] that says {says}',
            )
            require(
                table is None or kind in self.kinds,
                "kind",
                f'must be "{kind}", or have it in a list, since there is a table [device.{kind}]',
            )
        for key, seconds in (("start_s", self.start_s), ("converge_s", self.converge_s)):
            require(0.0 <= seconds <= 600.0, key, "must be 0 to 600")
        require(1 <= self.tumbles <= 10, "tumbles", "must be 1 to 10")
        require(1.0 <= self.tumble_s <= 600.0, "tumble_s", "must be 1 to 600")
        require(0.1 <= self.window_s <= 60.0, "window_s", "must be 0.1 to 60")
        require(
            2.0 * self.window_s <= self.settle_s <= 600.0, "settle_s", "must be at least two windows, and at most 600"
        )
        strangers = sorted(set(self.sources.values()) - set(self.kinds))
        require(not strangers, "sources", f"names {', '.join(strangers)}, which kind does not have")

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds as a tuple."""
        return (self.kind,) if isinstance(self.kind, str) else self.kind

    @property
    def speaks_our_protocol(self) -> bool:
        """True if the firmware uses hiltest's protocol."""
        return self.kinds == ("hiltest",)
