"""The run as data: its measurements, `run.json` and the journal, their reader, the files and the exit codes."""
