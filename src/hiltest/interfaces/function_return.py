"""Halting firmware at the return of a function, when the function's output is complete."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from hiltest.errors import ConfigError, DebugServerError
from hiltest.interfaces.gdb_client import GdbClient

_EXCEPTION_RETURN = 0xFFFFFF00  # values from this on are not return addresses but those of exception handlers
_MOST_OTHER_HALTS = 64  # halts at the return address of another call, or for other reasons


def halt_at_return(client: GdbClient, entry: int, within_s: float) -> bool:
    """Let halted firmware run until a call of a function has returned, and halt it there.

    A return is recognised by its address and by the stack pointer, which equals that at the call.

    Parameters
    ----------
    entry
        Address of the function.
    within_s
        Longest wait for the call, and then for its return [s of the board].

    Returns
    -------
    bool
        True if there was a call that returned. The firmware is halted either way.

    Raises
    ------
    ConfigError
        When the function is an exception handler.
    DebugServerError
        When the server is gone, or the processor halts repeatedly for other reasons.
    """
    if client.registers().pc & ~1 == entry:
        client.step()  # a server may halt again at once on a breakpoint that it continues from
    with _breakpoint(client, entry):
        if not _run_to(client, entry, within_s):
            return False
    called = client.registers()
    if called.lr >= _EXCEPTION_RETURN:
        raise ConfigError(
            f"the function at 0x{entry:08x} is an exception handler without a return address; name a function that "
            "it calls"
        )
    back, end_s = called.lr & ~1, client.now() + within_s
    for _ in range(_MOST_OTHER_HALTS):
        with _breakpoint(client, back):
            if not _run_to(client, back, end_s - client.now()):
                return False
        if client.registers().sp == called.sp:
            return True
        client.step()  # the return of a call within the call
    raise DebugServerError(client.name, f"the call at 0x{entry:08x} never returns with its stack pointer")


@contextmanager
def _breakpoint(client: GdbClient, address: int) -> Iterator[None]:
    """Set a breakpoint that is always cleared at the end; the processor is halted then, unless the server is gone."""
    client.set_breakpoint(address)
    try:
        yield
    finally:
        client.halt()
        client.clear_breakpoint(address)


def _run_to(client: GdbClient, address: int, within_s: float) -> bool:
    """Let the firmware run until it halts at an address; return False on a timeout."""
    end_s = client.now() + within_s
    for _ in range(_MOST_OTHER_HALTS):
        client.go_on()
        if client.wait_for_halt(end_s - client.now()) is None:
            return False
        if client.registers().pc & ~1 == address:
            return True
    raise DebugServerError(
        client.name,
        f"the processor halts at 0x{client.registers().pc:08x} repeatedly, without a breakpoint of hiltest; clear "
        "those of other debuggers, and check the firmware for faults",
    )
