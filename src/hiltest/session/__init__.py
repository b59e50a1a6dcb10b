"""One pytest session with hiltest in it: what was asked for, what the tests need, what they found, and the bench."""

from hiltest.session.session import SESSION, HilSession

__all__ = ["SESSION", "HilSession"]
