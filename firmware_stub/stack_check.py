"""How deep the stack can get: the deepest chain of calls from main, plus the deepest interrupt on top of it.

Reads what `-fcallgraph-info=su` writes beside every object: frames and calls. Calls through pointers are
resolved by the table below; one that is not in it is an error, and so is recursion or a frame whose size is
not known when compiling.
"""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from pathlib import Path

# Who calls through a pointer, and what that pointer can be.
INDIRECT_CALLS = {
    "server_run": ["command_*"],
    "main": ["*_set_up"],  # of the compass, like the next
    "measure": ["mag3110_read", "lis3mdl_read", "fxos8700_read", "lsm303agr_*_read"],
    "say": ["i3g4250d_read"],
    "count_cycles": ["magnetometer_*"],
    "count_step_cycles": ["*_stream_add", "*_stream_remove", "point_range_add"],
    "count_report_cycles": ["*_stream_report"],
    "count_sequence": ["sequence"],  # in assembly, with 40 bytes each: as what comes from the libraries
    "command_reset_stream": ["*_stream_reset"],
    "count_work_cycles": ["empty_work", "fit_*"],
    "for_each_sample": ["take_*"],
    "command_fit_accelerometer": ["accelerometer_*_residual_mg"],
    "count_update_cycles": ["*attitude_filter_update"],
    "I2C0_Handler": ["after_*"],
    "I2C1_Handler": ["after_*"],
    "sensor_read_if_ready": ["axes_*"],
    "sensor_read_latest": ["axes_*"],
    "sensor_fifo_read": ["axes_*"],
    "wait_for_condition_or_tick": ["is_idle", "never", "bytes_wait", "all_handed_over"],
    "wait_briefly": ["is_idle", "never", "bytes_wait", "all_handed_over"],
    "wait_until": ["is_idle", "never", "bytes_wait", "all_handed_over"],
}
# Frames of functions in assembly [bytes], which no compiler lists; a test measures them. And of sine and cosine with
# all that they call, which reduces large angles.
ASSEMBLY_FRAMES = {
    "quadric_fit": 212,
    "gravity_reduce": 48,
    "joint_make_rows": 92,
    "joint_add_rows": 64,
    "cosf": 480,
    "sinf": 480,
}
# Frames of what else comes from the compiler's libraries are not listed: the deepest, atan2f, takes less than this.
LIBRARY_BYTES = 128
# The core stacks 8 words, 18 more for the FPU, and one to align; all interrupts have one priority, so only one
# is ever on top.
EXCEPTION_FRAME_BYTES = 27 * 4

_NODE = re.compile(r'node: { title: "([^"]+)" label: "[^"]*\\n(\d+) bytes \(([a-z,]+)\)')
_EDGE = re.compile(r'edge: { sourcename: "([^"]+)" targetname: "([^"]+)"')
_INDIRECT = "__indirect_call"


class StackError(Exception):
    """The depth of the stack is not known, or too large."""


def _short(title: str) -> str:
    """Name of a function; those that are static in a file come as path:name."""
    return title.rsplit(":", 1)[-1]


def read_call_graph(build: Path) -> tuple[dict[str, int], dict[str, set[str]]]:
    """Read all functions' frames [bytes] and calls below a build folder."""
    frames: dict[str, int] = dict(ASSEMBLY_FRAMES)
    calls: dict[str, set[str]] = {}
    for path in sorted(build.rglob("*.ci")):
        text = path.read_text()
        for title, size, kind in _NODE.findall(text):
            if kind != "static":
                raise StackError(f"the frame of {_short(title)} is {kind}: its size must be known when compiling")
            frames[_short(title)] = max(int(size), frames.get(_short(title), 0))
        for source, target in _EDGE.findall(text):
            calls.setdefault(_short(source), set()).add(_short(target))
    return frames, calls


def _targets(function: str, frames: dict[str, int], calls: dict[str, set[str]]) -> set[str]:
    found = set(calls.get(function, ()))
    # The compiler merges functions that are alike: of one that calls through a pointer, the name alone is left.
    if _INDIRECT in found or function not in frames:
        found.discard(_INDIRECT)
        if function not in INDIRECT_CALLS:
            raise StackError(f"{function} calls through a pointer; say in stack_check.py what it can call")
        found |= {name for name in frames for pattern in INDIRECT_CALLS[function] if fnmatchcase(name, pattern)}
        found |= {pattern for pattern in INDIRECT_CALLS[function] if "*" not in pattern}
    return found


def deepest(function: str, frames: dict[str, int], calls: dict[str, set[str]], above: tuple[str, ...] = ()) -> int:
    """Return the stack that a function and all it calls can need [bytes]."""
    if function in above:
        raise StackError("recursion: " + " -> ".join((*above, function)))
    if function not in frames and function not in INDIRECT_CALLS:
        return LIBRARY_BYTES
    below = [deepest(target, frames, calls, (*above, function)) for target in _targets(function, frames, calls)]
    return frames.get(function, LIBRARY_BYTES) + max(below, default=0)


def stack_bytes(build: Path) -> int:
    """Return the deepest stack of the whole firmware [bytes]."""
    frames, calls = read_call_graph(build)
    for function in frames:  # also those that no chain from main reaches through known pointers
        deepest(function, frames, calls)
    handlers = [name for name in frames if name.endswith("_Handler") and name not in ("Reset_Handler", "Fault_Handler")]
    interrupt = max(deepest(name, frames, calls) for name in handlers)
    return deepest("Reset_Handler", frames, calls) + EXCEPTION_FRAME_BYTES + interrupt
