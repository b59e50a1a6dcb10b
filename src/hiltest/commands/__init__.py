"""The commands of ``hiltest``, one module per command; `hiltest.commands.cli` imports only the one that is called."""
