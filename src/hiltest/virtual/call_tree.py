"""The running function, and the path of calls that led to it.

Followed from one block to the next: BL and BLX call, an indirect transfer to where a call would come back to
returns, and what jumps into another function is a tail call, under the function that made it. Inlined code is
part of the function that it was inlined into. A function that calls itself stays one node.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from hiltest.virtual.blocks import CodeBlock
from hiltest.virtual.elf import FirmwareImage
from hiltest.virtual.instructions import Instruction

_LINK_REGISTER = 1 << 14
_DEEPEST = 100  # from here on a function that calls itself through others goes back to its own node
_COLD = ".cold"  # the part of a function that the compiler moves away because it hardly ever runs


class CallNode:
    """One function as it was reached along one path.

    Attributes
    ----------
    address : int
        Where the function begins.
    entries : int
        How often it was called, tail calls included.
    runs : dict
        Blocks that ran here, as (block, whether execution went on at its end, how often), by identity.
    asleep_cycles : int
        Cycles in which no instruction ran.
    """

    __slots__ = ("address", "asleep_cycles", "children", "depth", "entries", "name", "parent", "runs")

    def __init__(self, name: str, address: int, parent: CallNode | None) -> None:
        self.name = name
        self.address = address
        self.parent = parent
        self.depth: int = parent.depth + 1 if parent else 0
        self.children: dict[int, CallNode] = {}
        self.entries = 0
        self.runs: dict[tuple[int, bool], tuple[CodeBlock, bool, int]] = {}
        self.asleep_cycles = 0

    def ran(self, block: CodeBlock, *, went_on: bool) -> None:
        """Count one more run of a block."""
        key = id(block), went_on
        _, _, count = self.runs.get(key, (block, went_on, 0))
        self.runs[key] = block, went_on, count + 1

    def path(self) -> tuple[CallNode, ...]:
        """Return the nodes from the root to this one."""
        nodes, node = [self], self.parent
        while node is not None:
            nodes.append(node)
            node = node.parent
        return tuple(reversed(nodes))

    def walk(self) -> Iterator[CallNode]:
        """Yield this node and all below it."""
        waiting = [self]
        while waiting:
            node = waiting.pop()
            yield node
            waiting += node.children.values()


@dataclass(frozen=True, slots=True)
class _Frame:
    """A call that has not returned: where it will, with which stack pointer, and what it entered."""

    return_address: int
    stack_pointer: int
    caller: CallNode
    entered: CallNode


class CallTree:
    """Follows execution through the functions of an image.

    Parameters
    ----------
    image : FirmwareImage
        Says which function an address belongs to.
    name, address
        The function that is called.
    stack_pointer : callable
        Reads it.

    Attributes
    ----------
    root : CallNode
    current : CallNode
        Where execution is.
    """

    def __init__(self, image: FirmwareImage, name: str, address: int, stack_pointer: Callable[[], int]) -> None:
        self.root = self.current = CallNode(name, address, None)
        self.root.entries = 1
        self._image = image
        self._stack_pointer = stack_pointer
        self._frames: list[_Frame] = []
        self._owners: dict[int, tuple[str, int] | None] = {}

    def follow(self, last: Instruction, end: int, target: int) -> None:
        """Follow execution from `last`, which ends at `end`, to `target`."""
        jumped = last.transfer and (target != end or not last.conditional)
        if jumped and last.core_writes & _LINK_REGISTER:
            self._call(target, end)
        elif not (jumped and last.transfer == "indirect" and self._return(target)):
            self._move(target)

    def _call(self, target: int, return_address: int) -> None:
        # A call into code without a symbol still is one: it is named by its address.
        name, address = self._owner(target) or (f"{target:#x}", target)
        caller, self.current = self.current, self._child(name, address)
        self.current.entries += 1
        self._frames.append(_Frame(return_address, self._stack_pointer(), caller, self.current))

    def _return(self, target: int) -> bool:
        """Leave the innermost call that comes back to `target`; False when none does."""
        if not any(frame.return_address == target for frame in self._frames):
            return False
        stack_pointer = self._stack_pointer()
        for index in range(len(self._frames) - 1, -1, -1):
            frame = self._frames[index]
            # A lower stack pointer than at the call: a jump within a deeper recursion, no return.
            if frame.return_address == target and stack_pointer >= frame.stack_pointer:
                self.current = frame.caller
                del self._frames[index:]
                return True
        return False

    def _move(self, target: int) -> None:
        """Go on in the same function, or in another one that was jumped to."""
        owner = self._owner(target)
        if owner is None or owner[1] == self.current.address:
            return
        self.current = self._left_by_tail_call(owner[1]) or self._child(*owner)
        self.current.entries += target == owner[1]

    def _left_by_tail_call(self, address: int) -> CallNode | None:
        """Find a function that jumped away since the last call: coming back to it makes the tree no deeper."""
        outermost = self._frames[-1].entered if self._frames else self.root
        node = self.current
        while node is not outermost and node.parent is not None:
            node = node.parent
            if node.address == address:
                return node
        return None

    def _child(self, name: str, address: int) -> CallNode:
        if address == self.current.address:
            return self.current
        child = self.current.children.get(address)
        if child is None and self.current.depth >= _DEEPEST:
            child = next((node for node in reversed(self.current.path()) if node.address == address), None)
        if child is None:
            child = self.current.children[address] = CallNode(name, address, self.current)
        return child

    def _owner(self, address: int) -> tuple[str, int] | None:
        """Name and start of the function that an address belongs to."""
        if address not in self._owners:
            self._owners[address] = self._find_owner(address)
        return self._owners[address]

    def _find_owner(self, address: int) -> tuple[str, int] | None:
        if address == self.root.address:
            return self.root.name, address
        symbol = self._image.function_at(address)
        if symbol is None:
            return None
        if symbol.address == self.root.address:
            return self.root.name, symbol.address
        if _COLD in symbol.name:
            symbol = self._image.symbols.get(symbol.name.partition(_COLD)[0], symbol)
        return symbol.name, symbol.address
