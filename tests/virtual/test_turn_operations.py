"""What instructions do to the values of many turns at once, where no program would come to it by chance."""

from __future__ import annotations

import pytest

from hiltest.virtual.waits.intervals import FALSE, TRUE, Place, Value
from hiltest.virtual.waits.operations import compiled
from hiltest.virtual.waits.state import NotProvable, NotUniform, TurnState

JUMP_IF_HIGHER = bytes.fromhex("88bf1847")  # it hi; bxhi r3
HERE, TARGET = 0x100, 0x200


class Nothing:
    """Surroundings in which every place holds zero, and no peripheral answers."""

    def held(self, _place: Place) -> int:
        return 0

    def is_register(self, _address: int) -> bool:
        return False

    def read(self, _address: int, _size: int, _cycle: int, _turns: int) -> Value:
        raise AssertionError


def run(carry: Value, target: Value) -> None:
    state = TurnState(Nothing(), {}, turns=9)
    state.set("c", carry)
    state.set("z", FALSE)
    state.set(3, target)
    for _, operation in compiled(HERE, JUMP_IF_HIGHER, transfers=True, jumps=True, goes_to=TARGET):
        operation(state)


def test_a_jump_under_a_condition_is_alike_where_all_turns_make_it_to_the_same_place() -> None:
    run(TRUE, Value(TARGET | 1))


@pytest.mark.parametrize(
    ("carry", "target", "refused"),
    [
        (FALSE, Value(TARGET | 1), NotUniform),  # no turn jumps, and this one did
        (Value(0, 1), Value(TARGET | 1), NotUniform),
        (TRUE, Value(TARGET + 4 | 1), NotUniform),
        (TRUE, Value(TARGET | 1, 4), NotProvable),
        (Value(0, 1, stale=True), Value(TARGET | 1), NotProvable),
    ],
    ids=["never", "sometimes", "elsewhere", "to many places", "as nobody knows"],
)
def test_a_jump_that_other_turns_do_not_make_ends_the_proof(
    carry: Value, target: Value, refused: type[Exception]
) -> None:
    with pytest.raises(refused):
        run(carry, target)
