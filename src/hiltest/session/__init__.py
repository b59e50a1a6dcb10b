"""One pytest session with hiltest in it: what was asked for, what the tests need, what they found, and the bench."""

from hiltest.session.session import BENCH_LOST, SESSION, WRONG_FIRMWARE, HilSession

__all__ = ["BENCH_LOST", "SESSION", "WRONG_FIRMWARE", "HilSession"]
