"""``hiltest serve``: serve the virtual board and its turntable on real serial ports, in paced time."""

from __future__ import annotations

import contextlib
import math
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hiltest.commands.options import NumberRange, json_option, load_named_rig, parsed, setting_option
from hiltest.errors import BenchError, ConfigError
from hiltest.json_files import json_line
from hiltest.session.settings import file_name

if TYPE_CHECKING:
    from hiltest.boards.bench import VirtualBench
    from hiltest.boards.paced import PacedBench
    from hiltest.boards.served_lines import PortLine
    from hiltest.virtual.board.virtual_machine import VirtualMachine

_EXIT_CODES = """
\b
Exit codes:
  0   ended by Ctrl-C, another signal, --until, or the end of a recording
  4   usage: an option, a port, a rig file or a firmware file is wrong
  20  the firmware faulted, or hung in a state that no interrupt ends; a
      recorded line broke, or a program sent other bytes than recorded
"""
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_LOOK_EVERY_S = 0.2
# Longest wait for firmware that the host cannot run in time.
_START_S = 2.0
# A board that is farther behind wall time than this is no longer realistic [s].
_BEHIND_S = 3.0
_LAST_PORT = 65_535
_PORTS = click.IntRange(0, _LAST_PORT)


@dataclass(frozen=True, slots=True)
class Served:
    """The ports of a board, in one line, as soon as they can be opened; the command keeps running."""

    board: str
    turntable: str | None
    """Names of their ports; with ``--replay`` there is no turntable."""
    uarts: dict[str, str]
    """Ports of further UARTs, by name."""
    gdb: str | None
    """Address for GDB; null without ``--gdb``."""
    firmware: str
    rig: str
    cycle_model: str
    """Firmware, rig and cycle model of the served board."""


@click.command(epilog=_EXIT_CODES)
@click.option(
    "--tcp", type=_PORTS, metavar="PORT", help="Serve on a TCP port instead of pseudo-terminals; 0 selects a free port."
)
@click.option(
    "--turntable-tcp", type=_PORTS, metavar="PORT", help="Serve the turntable on this TCP port.  [default: PORT+1]"
)
@click.option(
    "--host",
    metavar="ADDRESS",
    default="127.0.0.1",
    show_default=True,
    help="Listen on this address for TCP. Unless it is a loopback address, clients must send the token of the "
    "printed URL first.",
)
@click.option(
    "--link",
    metavar="PATH",
    callback=parsed(file_name),
    help="Make PATH a symbolic link to the board's pseudo-terminal, and PATH-turntable to the turntable's.",
)
@setting_option("rig")
@setting_option("firmware")
@setting_option("base")
@setting_option("seed")
@click.option(
    "--baud",
    metavar="N",
    type=click.IntRange(min=1),
    help="Set the baud rate of the line at the board's UART.  [default: the rig's]",
)
@click.option(
    "--uart",
    "uarts",
    metavar="N[=WHERE]",
    multiple=True,
    help="Serve also UART1 to UART5: 3 on a pseudo-terminal, 3=PATH with a symbolic link to it, "
    "3=tcp:PORT on a TCP port. Repeat the option for several.",
)
@click.option(
    "--flash-file",
    metavar="FILE",
    callback=parsed(file_name),
    help="Keep the flash in FILE between runs, except the sectors of the firmware image.",
)
@click.option(
    "--no-wait",
    is_flag=True,
    help="Start the board at once.  [default: hold it in reset until a program opens a port]",
)
@click.option(
    "--until",
    metavar="S",
    type=NumberRange(min=0.0, min_open=True),
    default=math.inf,
    help="End at this virtual time.  [default: never]",
)
@click.option(
    "--replay",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Serve the serial line of a recorded run instead of a board: see docs/replay.md.",
)
@json_option("hiltest.serve/1, in one line as soon as the ports are open")
@click.option(
    "--gdb",
    type=_PORTS,
    metavar="PORT",
    help="Accept GDB on this TCP port; 0 selects a free port. See docs/debug.md.",
)
def serve(
    tcp: int | None,
    turntable_tcp: int | None,
    host: str,
    link: str | None,
    uarts: tuple[str, ...],
    no_wait: bool,
    until: float,
    gdb: int | None,
    replay: Path | None,
    as_json: bool,
    **described: Any,
) -> int:
    """Serve the virtual board and its turntable on serial ports.

    The command prints the name of each port, which any serial program can open. The board runs by itself, never ahead
    of wall time. The turntable speaks Grbl, and its M8 resets the board: see docs/serve.md.
    """
    if tcp is None and (turntable_tcp is not None or (host != "127.0.0.1" and gdb is None)):
        raise ConfigError("--turntable-tcp and --host need --tcp PORT")
    if tcp is not None and link:
        raise ConfigError("--link is for pseudo-terminals: leave out --tcp or --link")
    if tcp == _LAST_PORT and turntable_tcp is None:
        raise ConfigError(f"there is no TCP port after {tcp} for the turntable: name one with --turntable-tcp")
    if replay is not None:
        if (
            turntable_tcp is not None
            or uarts
            or no_wait
            or gdb is not None
            or any(value is not None for value in described.values())
        ):
            raise ConfigError("--replay serves a recorded line, and accepts only --tcp, --host, --link and --until")
        return _serve_recording(replay, tcp, host, link, until, as_json=as_json)
    from hiltest.boards.gdb_server import GdbServer
    from hiltest.boards.paced import PacedBench, SerialPortOfBoard
    from hiltest.boards.simulated_grbl import GrblTable
    from hiltest.boards.table_axes import TableAxes
    from hiltest.boards.uart_ports import opened_ports, uart_ports

    asked_for = uart_ports(uarts)
    bench = _bench(**described)
    machine = bench.machine
    with contextlib.ExitStack() as stack:
        ending = stack.enter_context(_collect_signals())
        lines = _open_lines(stack, tcp, turntable_tcp, host)
        urls = _link_ports(stack, lines, link)
        further = stack.enter_context(opened_ports(asked_for, host))
        model = machine.processor.profile.name
        about = f"virtual {machine.title.replace(' ', '-')} {model}"
        table = GrblTable(TableAxes(bench), about=about, reset=machine.reset)
        machine.boot()  # before GDB can connect
        debugger = None if gdb is None else GdbServer(machine, gdb, host=host)
        held = None if no_wait else lambda: debugger is None or not debugger.connected
        devices = ((line, SerialPortOfBoard(machine, machine.uarts[port.number])) for port, line, _ in further)
        paced = PacedBench(bench, lines[0], (lines[1], table), *devices, held=held, until_s=until)
        stack.callback(paced.stop)
        if debugger is not None:
            stack.callback(debugger.close)  # it releases the board's thread, which is waited for later
        paced.power_on()
        if held or _wait_for_start(paced, ending):
            urls_of_uarts = {port.name: url for port, _, url in further}
            gdb_at = None if debugger is None else f"{debugger.token}@{host}:{debugger.port}".lstrip("@")
            if as_json:
                _print_served(
                    Served(urls[0], urls[1], urls_of_uarts, gdb_at, bench.firmware.name, bench.rig.name, model)
                )
            else:
                urls_by_name = {"board": urls[0], "turntable": urls[1], **urls_of_uarts, "gdb": gdb_at}
                click.echo("\n".join(f"{name}: {url}" for name, url in urls_by_name.items() if url))
            faults = bench.rig.faults
            if faults is not None and faults.board_faults:
                _tell(f"injected faults: {'; '.join(map(str, faults.board_faults))}")
            if faults is not None and faults.has_line_faults:
                _tell(
                    f"the line faults of {bench.rig.path} are not simulated: declare them in the rig of the port's user"
                )
            if bench.playback:
                _tell(bench.playback.described())
            waits = ", in reset until a program opens a port" if held else ""
            _tell(f"serving {bench.firmware.name} in {bench.rig.name}, cycle model {model}{waits}; Ctrl-C ends it")
            served = dict(zip(("board", "turntable"), lines, strict=True))
            _watch(paced, machine, served | {port.name: line for port, line, _ in further}, ending)
    _sum_up(paced, bench)
    if paced.fault is not None:
        raise paced.fault
    return 0


def _serve_recording(file: Path, tcp: int | None, host: str, link: str | None, until_s: float, *, as_json: bool) -> int:
    """Serve a recorded line to each program from its beginning, until it has ended."""
    from hiltest.boards.served_lines import PseudoTerminal, TcpLine, port_link
    from hiltest.boards.served_recording import ServedRecording, serve_recorded
    from hiltest.tape.recorded_run import read_transcript

    recorded, transcript = read_transcript(file)
    with contextlib.ExitStack() as stack:
        ending = stack.enter_context(_collect_signals())
        line: PortLine = PseudoTerminal() if tcp is None else TcpLine(host, tcp)
        stack.callback(line.close)
        if link is not None:
            stack.enter_context(port_link(Path(link), line.url))
        url = link or line.url
        if as_json:
            _print_served(Served(url, None, {}, None, file.name, recorded.rig_file, "recorded"))
        else:
            click.echo(f"board: {url}")
        _tell(f"serving the line of {file}, recorded {recorded.recorded_utc}; Ctrl-C ends it")
        serve_recorded(ServedRecording(transcript, file), line, _tell, lambda now_s: bool(ending) or now_s > until_s)
    return 0


def _print_served(document: Served) -> None:
    """Print the document in one line, since programs read it while the command goes on."""
    click.echo(json_line({"schema": "hiltest.serve/1", **asdict(document)}))


def _sum_up(paced: PacedBench, bench: VirtualBench) -> None:
    """Print a summary of a board that has ended."""
    machine = bench.machine
    for sentence in bench.said_of_playback:
        _tell(sentence)
    device = bench.rig.device
    is_text = device is not None and device.kinds == ("text",)
    remark = paced.input.remark(paced.time_s, wrong_speed=machine.uart0.wrong_speed, is_text=is_text)
    if remark and not bench.rig.answers_requests:
        _tell(f"board: {remark}")
    if unanswered := machine.unanswered_part():
        _tell(f"board: {unanswered}")
    for uart in machine.uarts[1:]:
        if uart.host_waiting:
            _tell(f"board: {uart.host_waiting} bytes came on {uart.name}: serve it by --uart {uart.name[-1]}")
    for access in machine.unmodelled:
        _tell(f"{access}; {access.accesses} access{'es' if access.accesses > 1 else ''}")
    pace = f"{paced.time_s / paced.wall_s:.2f} x real time, " if paced.wall_s > 0.0 else ""
    where = "" if paced.fault else f"; {machine.position()}"
    _tell(f"board: {paced.time_s:.3f} s of virtual time, {pace}{paced.busy_s:.1f} s of it emulated{where}")


def _bench(
    rig: str | None,
    firmware: Path | None,
    base: int | None,
    seed: int | None,
    baud: int | None,
    flash_file: str | None,
) -> VirtualBench:
    from hiltest.boards.bench import VirtualBench

    described = load_named_rig(rig)
    if described.world is None:
        raise ConfigError(
            f"rig {described.name} ({described.path}) has a {described.board.kind} board, which cannot be served. "
            "Choose a rig with a virtual board by --rig"
        )
    bench = VirtualBench(
        described,
        firmware=firmware,
        seed=seed,
        base=base,
        flash_file=Path(flash_file) if flash_file else None,
    )
    bench.machine.report_waits(_tell)
    if baud is not None:
        for uart in bench.machine.uarts:
            uart.line_baud = baud
    return bench


def _open_lines(
    stack: contextlib.ExitStack, tcp: int | None, turntable_tcp: int | None, host: str
) -> Sequence[PortLine]:
    from hiltest.boards.served_lines import PseudoTerminal, TcpLine

    opened: list[PortLine] = []
    for port in (tcp, turntable_tcp if turntable_tcp is not None else tcp and tcp + 1):
        opened.append(PseudoTerminal() if tcp is None else TcpLine(host, port or 0))
        stack.callback(opened[-1].close)
    return opened


def _link_ports(stack: contextlib.ExitStack, lines: Sequence[PortLine], link: str | None) -> list[str]:
    if link is None:
        return [line.url for line in lines]
    from hiltest.boards.served_lines import port_link

    paths = [Path(link), Path(f"{link}-turntable")]
    for path, line in zip(paths, lines, strict=True):
        stack.enter_context(port_link(path, line.url))
    return [str(path) for path in paths]


@contextlib.contextmanager
def _collect_signals() -> Iterator[list[int]]:
    """Return a list that collects signals, which then do not interrupt."""
    came: list[int] = []
    # A user who starts the command under nohup wants it to survive SIGHUP.
    numbers = [number for number in _ENDING if signal.getsignal(number) is not signal.SIG_IGN]
    before = [signal.signal(number, lambda number, _frame: came.append(number)) for number in numbers]
    try:
        yield came
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _wait_for_start(paced: PacedBench, ending: list[int]) -> bool:
    """Wait until the firmware has started; return False if a signal comes or the firmware ends before."""
    from hiltest.boards.bench import START_UP_S

    gives_up_s = time.monotonic() + _START_S
    while paced.running and not ending and paced.time_s < START_UP_S and time.monotonic() < gives_up_s:
        time.sleep(_LOOK_EVERY_S / 10.0)
    return paced.running and not ending


def _watch(paced: PacedBench, machine: VirtualMachine, lines: dict[str, PortLine], ending: list[int]) -> None:
    """Report changes until a signal comes or the board ends."""
    connected: dict[str, bool] = dict.fromkeys(lines, False)
    reported_lost: dict[str, int] = dict.fromkeys(lines, 0)
    pace, rows = _pace(), machine.display_rows()
    wrong_speed = reported_speed = ""
    while not ending:
        time.sleep(_LOOK_EVERY_S)
        before, wrong_speed = wrong_speed, machine.uart0.wrong_speed
        if wrong_speed and wrong_speed == before != reported_speed:  # start-up code may just be setting the speed
            reported_speed = wrong_speed
            _tell(f"board: {wrong_speed}")
        for name, line in lines.items():
            if line.connected != connected[name]:
                connected[name] = line.connected
                _tell(f"{name}: client {'connected' if connected[name] else 'gone'}")
            if line.queue.lost > reported_lost[name]:
                _tell(f"{name}: {line.queue.lost - reported_lost[name]} bytes from a client were lost")
                reported_lost[name] = line.queue.lost
        if machine.display_rows() != rows:
            rows = machine.display_rows()
            _tell(f"display: {' '.join(rows)}")
        pace(paced.behind_s)
        if not paced.running:
            if paced.fault is None and not paced.over:
                raise BenchError("the virtual board ended unexpectedly; the lines above have the reason")
            _tell("the time of --until is over" if paced.over else "the firmware has ended: the ports are closed")
            return


def _pace() -> Callable[[float], None]:
    """Return a function that reports when a board falls behind, twice as far behind, and is in time again."""
    tell_at_s = _BEHIND_S

    def look(behind_s: float) -> None:
        """Report the pace if it changed."""
        nonlocal tell_at_s
        if behind_s >= tell_at_s:
            _tell(f"board: {behind_s:.0f} s behind wall time: this machine is too slow or too busy")
            tell_at_s = 2.0 * behind_s
        elif behind_s < _BEHIND_S / 2.0 and tell_at_s > _BEHIND_S:
            _tell("board: in time again")
            tell_at_s = _BEHIND_S

    return look


def _tell(text: str) -> None:
    click.echo(text, err=True)
