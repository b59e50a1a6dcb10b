"""``python -m hiltest.virtual.native``: say which block hook runs, or build the one in C."""

from __future__ import annotations

import sys

from hiltest.virtual.native import counts_natively
from hiltest.virtual.native.build import LIBRARY, compile_library
from hiltest.virtual.native.library import missing_because


def main(arguments: list[str]) -> int:
    """Run the command; 0 when the hook in C is there."""
    if arguments not in ([], ["--build"]):
        print("usage: python -m hiltest.virtual.native [--build]", file=sys.stderr)
        return 4
    if arguments:
        reason = compile_library()
        if reason:
            print(f"not built: {reason}", file=sys.stderr)
            return 1
    if counts_natively():
        print(f"native: {LIBRARY}")
    else:
        print(f"python: {missing_because() or 'the environment asks for it'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
