"""All checks in order; if one fails, only the checks that depend on it are omitted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from datetime import date
from pathlib import Path
from typing import TypeAlias

from hiltest.boards import Board, open_board
from hiltest.boards.daplink import choose_board, machine_root
from hiltest.doctor.board_checks import BOARD_CHECKS, see_identity
from hiltest.doctor.check import Check, Health, check_from_error, failed, not_looked_at, ok
from hiltest.doctor.field_checks import model_field, see_declared_field, see_measured_field
from hiltest.doctor.host_checks import HOST_CHECKS, HostPort, flash_command, host_port
from hiltest.doctor.turntable_checks import see_poses, see_turntable
from hiltest.errors import (
    BenchError,
    ConfigError,
    HiltestError,
    NoBoardError,
    OtherFirmwareError,
    ProtocolError,
    SensorAbsentError,
    SyncError,
    VersionMismatchError,
    board_is_gone,
)
from hiltest.link.ports import open_port
from hiltest.link.session import Session
from hiltest.rig import Rig
from hiltest.run_record.exit_codes import ExitCode

BAUDS = (9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600)
# A synchronisation takes 20 ms at 9600 baud, each way, and USB some more.
_BAUD_DEADLINE_S = 0.15
_USB = "usb://"

Looks: TypeAlias = Mapping[str, Callable[[Board, Rig], Check]]


def examine(rig: Rig, *, port: str | None = None, root: Path | None = None, today: date) -> Iterator[Check]:
    """Yield each check as it is made.

    Parameters
    ----------
    port
        Serial port of a real board; takes precedence over the rig's.
    root
        Root folder of the machine whose devices are checked, as for `hiltest.boards.daplink.plugged_in`.
    today
        Date for the World Magnetic Model.

    Raises
    ------
    SeveralBoardsError
        If several boards are plugged in, and neither rig nor port names one.
    ConfigError
        If rig and port do not go together.
    """
    url = port or rig.board.port
    host: HostPort | NoBoardError | str
    if rig.board.kind == "virtual" and (url is None or url.startswith("hil:")):
        host, url = "the board is virtual, in this process", None
    else:
        host, url = _locate_board(url, root or machine_root())
    usable = not isinstance(host, NoBoardError)
    for name, look in HOST_CHECKS.items():
        if isinstance(host, HostPort):
            check = look(host)
            usable = usable and check.health is not Health.FAILED
        elif isinstance(host, NoBoardError) and name == "board":
            check = check_from_error(name, host)
        else:
            check = not_looked_at(name, host if isinstance(host, str) else "no board is present")
        yield check
    yield see_turntable(rig, root or machine_root())
    yield see_poses(rig)
    flash = flash_command(host) if isinstance(host, HostPort) else "on the machine with the board: hiltest flash"
    yield from _board_checks(rig, url, today, flash, usable=usable)


def _locate_board(url: str | None, root: Path) -> tuple[HostPort | NoBoardError | str, str | None]:
    """Return the device that a board is on, or the reason why it is not on this machine; and the URL to open."""
    if url is None or url.startswith(_USB):
        try:
            board = choose_board((url or "").removeprefix(_USB).strip("/"), root=root)
        except NoBoardError as error:
            return error, None
        return HostPort(root, board.port, board), str(board.port) if board.port else None
    if "://" in url:
        return f"{url} is not a device of this machine", url
    return host_port(Path(url), root), url


def _board_checks(rig: Rig, url: str | None, today: date, flash: str, *, usable: bool) -> Iterator[Check]:
    model = model_field(rig, today)
    looks: Looks = {
        **BOARD_CHECKS,
        "identity": lambda board, rig: see_identity(board, rig, flash),
        "measured field": lambda board, rig: see_measured_field(board, rig, model),
    }
    if not usable:
        yield from _omitted_checks(("answer", *looks), "the port cannot be used")
    elif not rig.answers_requests:
        yield from _omitted_checks(
            ("answer", *looks), "the firmware does not speak hiltest's protocol: see `hiltest listen`"
        )
    else:
        yield from _checks_when_open(rig, url, looks, flash)
    yield see_declared_field(rig, model)


def _checks_when_open(rig: Rig, url: str | None, looks: Looks, flash: str) -> Iterator[Check]:
    try:
        board = open_board(rig, port=url)
    except (BenchError, ProtocolError) as error:
        yield from _checks_when_unopened(rig, url, looks, error, flash)
        return
    with board:
        yield ok("answer", f"at {rig.link.baud} baud" if url else board.description)
        gone = False
        for name, look in looks.items():
            if gone:
                yield not_looked_at(name, "the board no longer answers")
                continue
            try:
                check = look(board, rig)
                board.session.refuse_reset()
            except SensorAbsentError as error:
                check = not_looked_at(name, str(error).partition(";")[0])
            except HiltestError as error:
                check = check_from_error(name, error)
                gone = isinstance(error, BenchError | ProtocolError) and board_is_gone(error)
            yield check


def _checks_when_unopened(
    rig: Rig, url: str | None, looks: Looks, error: BenchError | ProtocolError, flash: str
) -> Iterator[Check]:
    """Yield checks of the opening's progress, and another baud rate at which a board answers."""
    if isinstance(error, SyncError) and url is not None and (baud := _answering_baud(url, rig.link.baud)):
        finding = f"no answer at {rig.link.baud} baud, but at {baud} baud"
        yield failed(
            "answer", finding, f"write baud = {baud} under [link] in the rig, if that is the intended firmware"
        )
    elif isinstance(error, SyncError):
        finding = str(error).partition(". ")[0]
        yield failed("answer", finding, flash)
    elif isinstance(error, BenchError):
        yield check_from_error("answer", error, url)
    else:
        yield ok("answer", f"an answer at {rig.link.baud} baud")
    names = [*looks]
    if isinstance(error, OtherFirmwareError):
        yield ok(names.pop(0), "hiltest's")
    if isinstance(error, VersionMismatchError):
        finding, remedy = str(error).partition(". ")[0], f"{flash}, unless the firmware is yours"
        yield failed(names.pop(0), finding, remedy, ExitCode.WRONG_FIRMWARE)
    elif isinstance(error, ProtocolError):
        yield check_from_error(names.pop(0), error)
    yield from _omitted_checks(
        names, "no firmware answers" if isinstance(error, BenchError) else "another firmware answers"
    )


def _answering_baud(url: str, excluded: int) -> int | None:
    """Return another baud rate at which a board answers; None without one, or if the line has no baud rate."""
    if "://" in url and not url.startswith("rfc2217:"):
        return None
    for baud in BAUDS:
        if baud == excluded:
            continue
        try:
            session = Session(open_port(url, baud=baud), reply_deadline_s=_BAUD_DEADLINE_S, attempts=1)
        except (BenchError, ConfigError):
            continue  # the port does not support this rate
        try:
            session.synchronise()
        except VersionMismatchError:
            pass  # the firmware answers readably
        except (BenchError, ProtocolError):
            continue
        finally:
            session.close()
        return baud
    return None


def _omitted_checks(names: Iterable[str], because: str) -> Iterator[Check]:
    return (not_looked_at(name, because) for name in names)
