"""The commands of ``hiltest``, one module each; `hiltest.cli` imports the one that is called."""
