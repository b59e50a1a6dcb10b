"""Checks of a turntable: its motors on a port of their own, without turning it, and the poses that it takes."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path

from hiltest.doctor.check import Check, Health, check_from_error, failed, not_looked_at, ok, warning
from hiltest.doctor.host_checks import host_port, see_holders, see_permission
from hiltest.errors import HiltestError, TurntableError
from hiltest.link.grbl import GrblLine
from hiltest.link.ports import open_port
from hiltest.rig import Rig
from hiltest.verdict.exposed_causes import LEAST_SIGMAS, cause_pairs, noise_of_limits, poses_in
from hiltest.world import EarthField


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


def see_poses(rig: Rig) -> Check:
    """Compare the headings that known bugs answer at the rig's poses: all bugs should be told apart."""
    yaw_deg = rig.mounting.yaw_deg if rig.mounting else 0.0
    attitudes = [replace(pose, heading_deg=pose.heading_deg + yaw_deg) for pose in rig.procedure.known_angle_poses()]
    field = EarthField(rig.field.strength_ut, rig.field.dip_deg)
    weakest = cause_pairs(poses_in(attitudes, field.ned_ut, noise_of_limits(rig.limits)))[0]
    finding = (
        f"of all pairs of known bugs, {weakest.one} and {weakest.other} differ least at the {len(attitudes)} poses: by "
        f"{weakest.sigmas:.1f} standard deviations"
    )
    if weakest.sigmas >= LEAST_SIGMAS:
        return ok("poses", finding)
    return warning(
        "poses",
        finding,
        "under [procedure] in the rig, tilt the board about both axes at once (tilts_deg), and put it at 0, 90, 180 "
        "and 270 degrees (headings_deg are those less the mounting yaw)",
    )
