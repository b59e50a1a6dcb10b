"""Check of a turntable with motors on a port of their own, without turning it."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

from hiltest.doctor.check import Check, Health, check_from_error, failed, not_looked_at, ok
from hiltest.doctor.host_checks import host_port, see_holders, see_permission
from hiltest.errors import HiltestError, TurntableError
from hiltest.link.grbl import GrblLine
from hiltest.link.ports import open_port
from hiltest.rig import Rig


def see_turntable(rig: Rig, root: Path) -> Check:
    """Check that the motors' port is present and free, and that Grbl answers on it."""
    name, url = "turntable", rig.turntable.port
    if rig.turntable.kind != "grbl" or url is None:
        return not_looked_at(name, f"kind {rig.turntable.kind}, which has no port")
    if "://" not in url:
        port = host_port(Path(url), root)
        for check in (see_permission(port), see_holders(port)):
            if check.health is Health.FAILED:
                return replace(check, name=name)
    try:
        with closing(GrblLine(open_port(url, rig=rig.name))) as line:
            status = line.status()
    except TurntableError as error:
        finding = str(error).partition(". ")[0]
        return failed(name, finding, "write the table's port under [turntable] in the rig; the controller needs $10=1")
    except HiltestError as error:
        return check_from_error(name, error, url)
    where = ", ".join(f"{angle:g}" for angle in status.position)
    return ok(name, f"Grbl answers on {url}: {status.state} at {where} degrees")
