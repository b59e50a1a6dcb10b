"""The commands of ``hiltest``, one module per command; `hiltest.cli` imports only the one that is called."""
