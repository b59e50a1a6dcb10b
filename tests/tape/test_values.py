"""What a board answers comes back from a recording as it was, or is refused: a file is hostile until it is read."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hiltest.boards import (
    Board,
    BoardKind,
    RealBoard,
    ReplayBoard,
    Truth,
    VirtualBoard,
)
from hiltest.boards.replayed import FACTS_OF_OUTPUT, FACTS_WITH_REQUESTS
from hiltest.errors import BoardFault, ConfigError, DeviceTimeoutError, HiltestError
from hiltest.interfaces.quantities import Quantity
from hiltest.measurement import CycleRange
from hiltest.measurement.cycle_range import RowEffect
from hiltest.orientation.angles import Pose
from hiltest.tape.tape import LIVE, Taped
from hiltest.tape.values import member_of, plain, plain_error, restored, restored_error
from hiltest.world import Vector

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)


@pytest.mark.parametrize(
    ("hint", "value"),
    [
        (Pose | None, Pose(30.0, -5.5, 1 / 3)),
        (Pose | None, None),
        (CycleRange | None, CycleRange(1, 2, (RowEffect("fetch", 3, 4),))),
        (BoardKind, BoardKind.REAL),
        (dict[str, Vector], {"motor": (0.1, 0.2, 0.3)}),
        (dict[str, int | str], {"flash": 1, "ram": "unknown"}),
        (list[str], ["one", "two"]),
        (float, 1e-300),
        (dict[Quantity, str], {Quantity.HEADING: "deg"}),
        (np.ndarray | None, None),
    ],
)
def test_a_value_comes_back_as_it_was(hint: Any, value: Any) -> None:
    assert restored(hint, json.loads(json.dumps(plain(value)))) == value


def test_an_array_comes_back_as_it_was() -> None:
    truth = Truth(
        np.eye(3), np.ones(3), 48.5, 62.0, 0.4, 1e-3, np.eye(3) / 3.0, np.zeros(3), np.zeros(3), np.eye(3), 0.025
    )
    again = restored(Truth | None, json.loads(json.dumps(plain(truth))))
    assert isinstance(again, Truth)
    assert np.array_equal(again.accelerometer_response, truth.accelerometer_response)
    assert again.field_ut == truth.field_ut


def test_an_array_comes_back_as_the_integers_that_it_was() -> None:
    counts = np.array([[1, -2, 3]], dtype=np.int16)
    again = restored(NDArray[np.int16], json.loads(json.dumps(plain(counts))))
    assert (again.dtype, again.tolist()) == (counts.dtype, counts.tolist())
    with pytest.raises(ValueError, match="array"):
        restored(NDArray[np.int16], [40_000])


def test_numbers_that_are_keys_come_back_as_numbers() -> None:
    assert restored(dict[int, str], plain({3: "c"})) == {3: "c"}
    with pytest.raises(ValueError, match="invalid literal"):
        restored(dict[int, str], {"c": "c"})


@given(JSON, st.sampled_from([Pose, CycleRange | None, BoardKind, dict[str, Vector], list[int], Truth | None, bool]))
def test_whatever_a_file_holds_is_a_value_of_the_declared_type_or_a_valueerror(content: Any, hint: Any) -> None:
    try:
        result = restored(hint, content)
    except ValueError:
        return
    if isinstance(hint, type) and not hasattr(hint, "__args__"):
        assert isinstance(result, hint)


@pytest.mark.parametrize(
    "error",
    [
        BoardFault("divided by zero", pc=4, function="main", registers={"r0": 1}),
        DeviceTimeoutError("AVERAGE", 1.0, "virtual"),
        ConfigError("wrong"),
    ],
)
def test_an_error_comes_back_with_its_words_and_what_it_knows(error: HiltestError) -> None:
    again = restored_error(json.loads(json.dumps(plain_error(error))))
    assert type(again) is type(error)
    assert (str(again), vars(again)) == (str(error), vars(error))


@given(JSON | st.fixed_dictionaries({"error": st.sampled_from(["SystemExit", "Any", "ConfigError"]), "with": JSON}))
def test_a_file_makes_no_other_object_than_an_error(content: Any) -> None:
    with suppress(ValueError):
        assert isinstance(restored_error(content), HiltestError)


def test_what_cannot_be_recorded_is_refused_when_it_is_asked() -> None:
    with pytest.raises(TypeError, match="object cannot be recorded"):
        plain({"key": object()})


def test_an_object_on_tape_has_its_interface_and_no_more() -> None:
    class Bell(Protocol):
        def ring(self, times: int) -> int: ...

    @dataclass
    class Iron:
        weight: float = 1.0

        def ring(self, times: int) -> int:
            return 2 * times

    bell = Taped(LIVE, "bell", Bell, Iron())
    assert bell.ring(3) == 6
    with pytest.raises(AttributeError, match="Bell has no 'weight', which recording needs"):
        _ = bell.weight


def test_every_answer_that_a_kind_of_board_gives_in_its_own_way_is_recorded() -> None:
    for kind in (VirtualBoard, RealBoard):
        for name in vars(kind).keys() - {"kind"}:
            if not name.startswith("_"):
                member_of(Board, name)  # raises where the interface has it not
                assert name in FACTS_WITH_REQUESTS | FACTS_OF_OUTPUT


def test_a_replay_answers_for_itself_whatever_boards_answer_each_in_its_own_way() -> None:
    for name in FACTS_WITH_REQUESTS | FACTS_OF_OUTPUT:
        if isinstance(getattr(Board, name, None), property):
            assert name in vars(ReplayBoard), f"{name} would be answered as by a board that knows nothing"
