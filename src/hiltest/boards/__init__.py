"""Boards: virtual or real, behind one interface."""

from __future__ import annotations

from pathlib import Path

import serial

from hiltest.boards.bench import VirtualBench, default_firmware
from hiltest.boards.board import NO_COVERAGE, Board, BoardKind, Declared, OnChip, Stage, Truth
from hiltest.boards.daplink import port_of
from hiltest.boards.output_interface import OutputInterface
from hiltest.boards.protocol_interface import ProtocolInterface
from hiltest.boards.real import RealBoard
from hiltest.boards.replayed import ReplayBoard, put_on_tape
from hiltest.boards.virtual import VirtualBoard
from hiltest.errors import ConfigError, PortNotFoundError
from hiltest.link.replies import SensorKind
from hiltest.link.transcript import Transcript
from hiltest.rig import Rig
from hiltest.rig.rig import refuse_unknown_sensors
from hiltest.tape.player import Player
from hiltest.tape.tape import LIVE, Tape
from hiltest.virtual.program.elf import load_image

__all__ = [
    "Board",
    "BoardKind",
    "Declared",
    "OnChip",
    "OutputInterface",
    "ProtocolInterface",
    "RealBoard",
    "ReplayBoard",
    "Stage",
    "Truth",
    "VirtualBench",
    "VirtualBoard",
    "default_firmware",
    "open_board",
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
    """Open the board of a rig, with the interface of the rig: its firmware has answered, or reported something.

    Parameters
    ----------
    rig
        Rig with a ``[board]`` table.
    firmware
        ELF, Intel HEX or raw binary for a virtual board; the ELF on a real board whose variables are read by name.
    port
        Serial port of a real board, in place of the rig's. If neither is set, the only board that is plugged in.
    seed
        Seed of a simulated world; by default the rig's.
    transcript
        Receives every byte, in both directions.
    base
        Address of a raw binary.
    watches_execution
        True to record the instructions that the firmware executes; only a virtual board can.
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
        When another firmware answers, or its output cannot be interpreted.
    """
    if isinstance(tape, Player):
        return ReplayBoard(tape, rig, transcript=transcript)
    url = port or rig.board.port or (port_of() if rig.board.kind == "real" else None)
    board: Board
    if url is None or url.startswith("hil:"):
        if url is not None and url.rstrip("/") != "hil:":
            raise ConfigError(
                f"{url}: the URL has parameters that hiltest run takes from its options: use --port hil://"
            )
        bench = VirtualBench(rig, firmware=firmware, seed=seed, base=base, watches_execution=watches_execution)
        board = VirtualBoard(bench, transcript=transcript, tape=tape)
    else:
        if watches_execution:
            raise ConfigError(NO_COVERAGE.format(f"on {url}"))
        if firmware is not None and rig.answers_requests:
            raise ConfigError(f"--firmware is for the virtual board; flash {firmware} onto the board on {url}")
        image = None if firmware is None else load_image(firmware, base=base)
        try:
            board = RealBoard(url, rig, image=image, transcript=transcript, tape=tape)
        except PortNotFoundError as error:
            is_virtual = rig.board.kind == "virtual"
            raise PortNotFoundError(error.requested, error.available, of_virtual_rig=is_virtual) from error
    if board.answers_requests:
        _refuse_unknown_sensors(board, rig)
    if on_chip is not None:
        on_chip.note(board)
    if tape is not LIVE:
        put_on_tape(board, tape)
    return board


def _refuse_unknown_sensors(board: Board, rig: Rig) -> None:
    """Close the board and raise an error if its firmware has no driver for a sensor that the rig names."""
    names = {kind.name.lower(): [sensor.name for sensor in board.sensors if sensor.kind is kind] for kind in SensorKind}
    try:
        refuse_unknown_sensors(rig, names)
    except ConfigError:
        board.close()
        raise
