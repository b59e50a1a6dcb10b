"""Halting firmware where a call of a function has returned: what the function writes is whole there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from hiltest.device.gdb_client import GdbClient
from hiltest.errors import ConfigError, DebugServerError

_EXCEPTION_RETURN = 0xFFFFFF00  # a return address from here on is none: an exception handler has it
_MOST_OTHER_HALTS = 64  # at the return address of another call, or for no reason that this has


def halt_at_return(client: GdbClient, entry: int, within_s: float) -> bool:
    """Let halted firmware run until a call of a function has returned, and halt it there.

    A return is known by its address and by the stack pointer, which is that of the call.

    Parameters
    ----------
    entry
        Address of the function.
    within_s
        Longest that is waited for the call, and then for its return [s of the board].

    Returns
    -------
    bool
        Whether there was a call that returned. The firmware is halted either way.

    Raises
    ------
    ConfigError
        When the function is an exception handler.
    DebugServerError
        When the server is gone, or the processor halts for other reasons again and again.
    """
    if client.registers().pc & ~1 == entry:
        client.step()  # a server may halt at once where it goes on from a breakpoint
    with _breakpoint(client, entry):
        if not _reached(client, entry, within_s):
            return False
    called = client.registers()
    if called.lr >= _EXCEPTION_RETURN:
        raise ConfigError(f"the function at 0x{entry:08x} is an exception handler, which returns to no address; name a "
                          "function that it calls")  # fmt: skip
    back, end_s = called.lr & ~1, client.now() + within_s
    for _ in range(_MOST_OTHER_HALTS):
        with _breakpoint(client, back):
            if not _reached(client, back, end_s - client.now()):
                return False
        if client.registers().sp == called.sp:
            return True
        client.step()  # the return of a call within the call
    raise DebugServerError(client.name, f"the call at 0x{entry:08x} never returns with the stack pointer that it had")


@contextmanager
def _breakpoint(client: GdbClient, address: int) -> Iterator[None]:
    """Set a breakpoint that is cleared however it ends; the processor is halted then, unless the server is gone."""
    client.set_breakpoint(address)
    try:
        yield
    finally:
        client.halt()
        client.clear_breakpoint(address)


def _reached(client: GdbClient, address: int, within_s: float) -> bool:
    """Let the firmware run until it halts at an address; False when it has not in time."""
    end_s = client.now() + within_s
    for _ in range(_MOST_OTHER_HALTS):
        client.go_on()
        if client.wait_for_halt(end_s - client.now()) is None:
            return False
        if client.registers().pc & ~1 == address:
            return True
    raise DebugServerError(
        client.name, f"the processor halts at 0x{client.registers().pc:08x} again and again, where hiltest has set no "
        "breakpoint; clear those of other debuggers, and see whether the firmware faults"
    )  # fmt: skip
