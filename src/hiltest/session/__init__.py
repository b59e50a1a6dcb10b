"""One pytest session with hiltest in it: options, chosen tests, their findings, and the bench."""

from hiltest.session.session import SESSION, HilSession

__all__ = ["SESSION", "HilSession"]
