"""Reader of records: finished ones, and journals of runs that were cut short or still go on."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from hiltest.errors import ConfigError, NothingRecordedError
from hiltest.json_files import JsonFile, read_as, read_json
from hiltest.run_record.failures import describe_unfinished
from hiltest.run_record.files import CAMPAIGN_FILE, RUN_FILE, SEED_FOLDERS, SEEDS_FILE
from hiltest.run_record.journal import CUT_SHORT, JOURNAL_FILE, STILL_RUNNING, read_journal
from hiltest.run_record.run import SCHEMA, Run

OTHERWISE = "render another record, or run again: hiltest run"
"""The next step for a record that cannot be read."""

# A run can begin or finish between two looks at its folder.
_TRIES = 3


@dataclass(frozen=True, slots=True)
class RecordFile:
    """A record and its file."""

    run: Run
    file: JsonFile
    """``run.json`` or the journal; the content has the keys of ``run.json``, and those that only a newer hiltest knows,
    so that rewritten records are made from it."""


def read_record(place: Path) -> RecordFile:
    """Read the record of a run.

    Parameters
    ----------
    place
        Folder of a run, a ``run.json`` or a ``journal.jsonl``.

    Raises
    ------
    ConfigError
        For the reasons of `find_record` and `check_record`.
    """
    return check_record(find_record(place))


def find_seeds(place: Path) -> list[Path]:
    """Return the folders of a campaign's seeds, sorted; empty if the place is not the folder of a campaign.

    Raises
    ------
    ConfigError
        If the folder has a single run, too, and neither is known to be newer.
    """
    if not os.path.isdir(place):
        return []
    journal = place / JOURNAL_FILE
    # A campaign removes a single run before it begins; an empty journal belongs to a run that never began.
    has_run = (place / RUN_FILE).exists() or (journal.is_file() and journal.stat().st_size > 0)
    if has_run and (place / SEEDS_FILE).exists():
        raise ConfigError(
            f"{place}: has both a single run and a campaign ({SEEDS_FILE}); name the run's {RUN_FILE}, or run "
            "again with another --out"
        )
    return [] if has_run else sorted(folder for folder in place.glob(SEED_FOLDERS) if folder.is_dir())


def find_record(place: Path, *, otherwise: str = OTHERWISE) -> JsonFile:
    """Find and parse the file with the record of a run.

    Parameters
    ----------
    place
        A file, or the folder of a run: its journal counts if that run goes on or was cut short, else ``run.json``.
    otherwise
        Remedy for a file that is not JSON.

    Raises
    ------
    NothingRecordedError
        If there is no record.
    ConfigError
        If it is not JSON. Each message has the reason and a remedy.
    """
    if not os.path.isdir(place):
        try:
            return _parse_file(place, otherwise)
        except ConfigError as error:
            if os.path.exists(place):
                raise
            raise NothingRecordedError(str(error)) from error
    journal, record = place / JOURNAL_FILE, place / RUN_FILE
    for path in (journal, record) * _TRIES:
        try:
            file = _parse_file(path, otherwise)
        except NothingRecordedError:
            continue
        except ConfigError:
            if path.exists():
                raise
            continue
        # For a finished run, run.json has the same content as soon as it is written.
        if path == record or not record.exists() or file.content["verdict"] in (STILL_RUNNING, CUT_SHORT):
            return file
    if seeds := sorted(place.glob(SEED_FOLDERS)):
        page = place / CAMPAIGN_FILE
        state = f"all its seeds are in {page}" if page.exists() else f"cut short or going on, without {CAMPAIGN_FILE}"
        raise ConfigError(f"{place}: a campaign, not one run: {state}; name one of its folders, such as {seeds[0]}")
    raise NothingRecordedError(f"{place} has no record of a run: neither {RUN_FILE} nor a line in {JOURNAL_FILE}")


def _parse_file(path: Path, otherwise: str) -> JsonFile:
    return read_journal(path, otherwise=otherwise) if _is_journal(path) else read_json(path, otherwise=otherwise)


def _is_journal(path: Path) -> bool:
    return path.name.endswith(".jsonl")


def check_record(file: JsonFile) -> RecordFile:
    """Check the content of a record.

    Raises
    ------
    ConfigError
        If it is of another schema, or a field is missing or wrong. Unknown fields are no error.
    """
    run = read_as(file, Run, SCHEMA, otherwise=OTHERWISE)
    if not _is_journal(file.path):
        return RecordFile(run, file)
    if file.content["verdict"] in (STILL_RUNNING, CUT_SHORT):
        run = replace(run, verdict=describe_unfinished(run))
    run = run.add_derived_fields()
    notes = [measurement.note for measurement in run.measurements]
    derived = {
        "verdict": asdict(run.verdict),
        "measurements": [
            content | {"note": note} for content, note in zip(file.content["measurements"], notes, strict=True)
        ],
        "volatile": run.volatile,
        "tolerances": run.tolerances,
    }
    return RecordFile(run, replace(file, content=file.content | derived))
