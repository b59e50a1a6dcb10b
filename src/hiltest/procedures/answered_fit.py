"""The calibration in a board's answer, as the references give theirs."""

from __future__ import annotations

from hiltest.calibration.fit import MagnetometerFit
from hiltest.link.replies import CalibrateReply
from hiltest.link.streams import StreamStateReply


def fit_of(reply: CalibrateReply | StreamStateReply) -> MagnetometerFit:
    """Return what a calibrator of the board found [counts, body frame]."""
    found = reply.calibration
    return MagnetometerFit(
        reply.fit, reply.is_sphere, reply.iterations, found.soft_iron, found.hard_iron, reply.coverage
    )
