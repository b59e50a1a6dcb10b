"""How to keep what got better: the next change is then judged against it."""

from __future__ import annotations

from pathlib import PurePath
from shlex import quote

from hiltest.comparison.model import Answer, BaseKind, Change, Comparison


def how_to_keep(comparison: Comparison, run: str, options: str | None = None) -> str:
    """Return the command that moves what got better into the base, in one line.

    Parameters
    ----------
    comparison : Comparison
    run : str
        Where the new run is, as one would type it.
    options : str, optional
        What makes ``hiltest run`` run the same on other seeds, as one would type it; None where that is not known: a
        record does not say which files were named.

    Returns
    -------
    str
        Empty where nothing got better, the change is not to be merged, or the base is an older firmware's ELF: the
        next one is then judged against this one's.
    """
    better = comparison.of(Change.BETTER)
    if not better or comparison.answer is not Answer.MAY or comparison.base_kind is BaseKind.TOGETHER:
        return ""
    count = f"{len(better)} better; keep {'them' if len(better) > 1 else 'it'}: "
    if comparison.base_kind is BaseKind.RUN:
        save = f"{count}hiltest baseline save {quote(run)} FILE, and --baseline FILE from then on"
        return "" if comparison.chosen else save
    first, of = _all_seeds(comparison, run, options)
    names = " ".join(f"--accept {quote(each.name)}" for each in better)
    return f"{count}{first}hiltest baseline update {quote(comparison.base.file)} {of} {names} --because TEXT"


def _all_seeds(comparison: Comparison, run: str, options: str | None) -> tuple[str, str]:
    """Return what to run first where a seed of the baseline is missing, and where what is accepted lies then.

    A mean over some of the seeds says nothing. The campaign gets a folder of its own: in the run's it would take the
    place of what was just judged.
    """
    seeds = comparison.base.seeds
    if not set(seeds) - set(comparison.new.seeds):
        return "", quote(run)
    as_before, out = ("OPTIONS", "DIR") if options is None else (options, quote(str(PurePath(run) / "seeds")))
    command = " ".join(filter(None, ("hiltest run", as_before, f"--seeds {min(seeds)}..{max(seeds)} --out {out}")))
    what = "run its seeds" if options is not None else f"run its seeds with the OPTIONS that {quote(run)} was run with"
    return f"{what}, {command}, then ", out
