"""``python -m hiltest`` is the command ``hiltest``."""

from hiltest.cli import main

if __name__ == "__main__":
    main()
