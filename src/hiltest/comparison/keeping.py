"""How to keep what got better: the next change is then judged against it."""

from __future__ import annotations

from shlex import quote

from hiltest.comparison.model import Answer, BaseKind, Change, Comparison


def how_to_keep(comparison: Comparison, run: str) -> str:
    """Return the command that moves what got better into the base, in one line.

    Parameters
    ----------
    comparison : Comparison
    run : str
        Where the new run is, as one would type it.

    Returns
    -------
    str
        Empty where nothing got better, the change is not to be merged, or the base is an older firmware's ELF: the
        next one is then judged against this one's.
    """
    better = comparison.of(Change.BETTER)
    if not better or comparison.answer is not Answer.MAY or comparison.base_kind is BaseKind.TOGETHER:
        return ""
    count, run = f"{len(better)} better; keep {'them' if len(better) > 1 else 'it'}: ", quote(run)
    if comparison.base_kind is BaseKind.RUN:
        return "" if comparison.chosen else f"{count}hiltest baseline save {run} FILE, and --baseline FILE from then on"
    names = " ".join(f"--accept {quote(each.name)}" for each in better)
    update = f"hiltest baseline update {quote(comparison.base.file)} {run} {names} --because TEXT"
    return f"{count}{_all_seeds(comparison)}{update}"


def _all_seeds(comparison: Comparison) -> str:
    """Return what to run first where a seed of the baseline is missing: a mean over some of them says nothing."""
    seeds = comparison.base.seeds
    if not set(seeds) - set(comparison.new.seeds):
        return ""
    return f"run its seeds, hiltest run --seeds {min(seeds)}..{max(seeds)}, then "
