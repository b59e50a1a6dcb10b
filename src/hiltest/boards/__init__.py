"""Boards: virtual or real, behind one interface."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import serial

from hiltest.boards.bench import VirtualBench, default_firmware
from hiltest.boards.board import NO_COVERAGE, Board, BoardKind, Declared, OnChip, Stage, Truth
from hiltest.boards.compass import CompassBoard, opened_compass
from hiltest.boards.daplink import port_of
from hiltest.boards.real import RealBoard
from hiltest.boards.replayed import ReplayBoard, ReplayCompass, put_on_tape
from hiltest.boards.virtual import VirtualBoard
from hiltest.errors import ConfigError, PortNotFoundError
from hiltest.link.replies import SensorKind
from hiltest.link.transcript import Transcript
from hiltest.rig import Rig
from hiltest.rig.rig import refuse_unknown_sensors
from hiltest.tape.player import Player
from hiltest.tape.tape import LIVE, Tape

__all__ = [
    "Board",
    "BoardKind",
    "CompassBoard",
    "Declared",
    "OnChip",
    "RealBoard",
    "ReplayBoard",
    "ReplayCompass",
    "Stage",
    "Truth",
    "VirtualBench",
    "VirtualBoard",
    "default_firmware",
    "open_board",
    "open_compass",
]

# Makes hil:// and usb:// URLs that any program using pyserial in this process can open.
_HANDLERS = "hiltest.boards.urlhandler"
if _HANDLERS not in serial.protocol_handler_packages:
    serial.protocol_handler_packages.append(_HANDLERS)


def open_board(
    rig: Rig,
    *,
    firmware: Path | None = None,
    port: str | None = None,
    seed: int | None = None,
    transcript: Transcript | None = None,
    base: int | None = None,
    watches_execution: bool = False,
    tape: Tape = LIVE,
    on_chip: OnChip | None = None,
) -> Board:
    """Open the board of a rig: synchronised, identified, its sensors selected.

    Parameters
    ----------
    rig
        Rig with a ``[board]`` table.
    firmware
        ELF, Intel HEX or raw binary for a virtual board.
    port
        Serial port of a real board, in place of the rig's. If neither is set, the only board that is plugged in.
    seed
        Seed of a simulated world; by default the rig's.
    transcript
        Receives every byte, in both directions.
    base
        Address of a raw binary.
    watches_execution
        Whether to record the instructions that the firmware executes; only a virtual board can.
    tape
        Records all questions and answers, or answers from a recording.
    on_chip
        Facts about the firmware that has just been flashed.

    Raises
    ------
    ConfigError
        When rig, firmware and port do not go together.
    BenchError
        When the port cannot be opened, nothing answers, or the firmware faults.
    VersionMismatchError
        When another firmware answers.
    """
    declared = Declared.of(rig)
    if isinstance(tape, Player):
        return ReplayBoard(tape, declared=declared, transcript=transcript)
    board = _opened_board(
        rig,
        declared,
        firmware=firmware,
        port=port,
        seed=seed,
        transcript=transcript,
        base=base,
        watches_execution=watches_execution,
        tape=tape,
    )
    if on_chip is not None:
        on_chip.note(board)
    if tape is not LIVE:
        put_on_tape(board, tape)
    return board


def open_compass(
    rig: Rig,
    *,
    firmware: Path | None = None,
    port: str | None = None,
    seed: int | None = None,
    transcript: Transcript | None = None,
    base: int | None = None,
    watches_execution: bool = False,
    tape: Tape = LIVE,
    on_chip: OnChip | None = None,
) -> CompassBoard:
    """Open the board of a rig whose firmware has its own protocol, and wait for its first output; see `open_board`.

    Raises
    ------
    ConfigError
        When rig, firmware and port do not go together.
    BenchError
        When the port cannot be opened, the firmware stays silent, or it faults.
    VersionMismatchError
        When the output cannot be interpreted.
    """
    is_replay = isinstance(tape, Player)
    board = (
        ReplayCompass(tape, rig, transcript=transcript)
        if is_replay
        else opened_compass(
            rig,
            firmware=firmware,
            port=port,
            seed=seed,
            transcript=transcript,
            base=base,
            watches_execution=watches_execution,
            tape=tape,
        )
    )
    if on_chip is not None:
        on_chip.note(board)
    board.may_be_overheard = tape is LIVE
    try:
        board.begin()
        if isinstance(board, ReplayCompass):
            board.identify(tape)
        elif tape is not LIVE:
            put_on_tape(board, tape)
    except BaseException:
        with suppress(OSError):
            board.close()
        raise
    return board


def _opened_board(
    rig: Rig,
    declared: Declared,
    *,
    firmware: Path | None,
    port: str | None,
    seed: int | None,
    transcript: Transcript | None,
    base: int | None,
    watches_execution: bool,
    tape: Tape,
) -> Board:
    url = port or rig.board.port or (port_of() if rig.board.kind == "real" else None)
    if url is not None and not url.startswith("hil:"):
        if firmware is not None:
            raise ConfigError(f"--firmware is for the virtual board; flash {firmware} onto the board on {url}")
        if watches_execution:
            raise ConfigError(NO_COVERAGE.format(f"on {url}"))
        try:
            board = RealBoard(url, baud=rig.link.baud, declared=declared, transcript=transcript, tape=tape)
        except PortNotFoundError as error:
            is_virtual = rig.board.kind == "virtual"
            raise PortNotFoundError(error.requested, error.available, of_virtual_rig=is_virtual) from error
        return _refuse_unknown_sensors(board, rig)
    if url is not None and url.rstrip("/") != "hil:":
        raise ConfigError(f"{url}: the URL has parameters that hiltest run takes from its options: use --port hil://")
    bench = VirtualBench(rig, firmware=firmware, seed=seed, base=base, watches_execution=watches_execution)
    return _refuse_unknown_sensors(VirtualBoard(bench, declared=declared, transcript=transcript, tape=tape), rig)


def _refuse_unknown_sensors(board: Board, rig: Rig) -> Board:
    """Return the board, or raise an error if its firmware has no driver for a sensor that the rig names."""
    names = {kind.name.lower(): [sensor.name for sensor in board.sensors if sensor.kind is kind] for kind in SensorKind}
    try:
        refuse_unknown_sensors(rig, names)
    except ConfigError:
        board.close()
        raise
    return board
