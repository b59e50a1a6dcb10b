"""The run as data: what it measured, `run.json` and the journal, their reader, the files and the exit codes."""
