"""``python -m hiltest`` is the command ``hiltest``."""

from hiltest.commands.cli import main

if __name__ == "__main__":
    main()
