"""Which of the tests pytest was asked for: all that there are, or some that the user has chosen."""

from __future__ import annotations

import pytest

from hiltest.session.gate_set import LeftOut

# pytest's options that leave tests out.
_CHOICES = ("keyword", "markexpr", "deselect", "ignore", "ignore_glob", "lf", "stepwise")
_NOT_COLLECTED = ("ignore", "ignore_glob", "lf")
# Those that make it show something instead of running tests.
_LOOKS = ("collectonly", "showfixtures", "show_fixtures_per_test", "markers", "cacheshow", "help")


def only_looks(config: pytest.Config) -> bool:
    """Say whether pytest was asked to show something, such as the tests that there are, and to run none."""
    return any(vars(config.option).get(name) for name in _LOOKS)


class Choice:
    """Which tests a session runs, as far as it decides what may be missing from its record.

    Attributes
    ----------
    left_out : LeftOut
        Tests of the full set.
    deselected : bool
        Whether tests of hiltest that the set has were deselected.
    only_benchmarks : bool
        Whether pytest was asked for benchmarks of device cycles and for no other test of ours: they measure nothing
        that is judged.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self.left_out = LeftOut()
        self.deselected = False
        self.only_benchmarks = False

    @property
    def of_any_tests(self) -> bool:
        """Whether the user asked for a part of the tests: by ``-k``, ``-m``, ``--ignore``, files or node ids."""
        return self.only_benchmarks or self._has_given(_CHOICES) or self._named_tests

    @property
    def of_our_tests(self) -> bool:
        """Whether tests of hiltest may be missing by the user's choice: ``-m hil`` leaves out only others.

        What a conftest deselects is nobody's choice: it is missed.
        """
        deselected = self.deselected and self._has_given(_CHOICES)
        return deselected or self.only_benchmarks or self._has_given(_NOT_COLLECTED) or self._named_tests

    def _has_given(self, options: tuple[str, ...]) -> bool:
        given = vars(self._config.option)
        return any(given.get(name) for name in options)

    @property
    def _named_tests(self) -> bool:
        named = self._config.args if self._config.args_source is pytest.Config.ArgsSource.ARGS else []
        here = self._config.invocation_params.dir
        return bool(named) and not any("::" not in each and (here / each).is_dir() for each in named)
