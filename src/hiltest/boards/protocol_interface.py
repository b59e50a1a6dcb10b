"""hiltest's protocol as the interface to firmware: requests, each of which the firmware answers."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hiltest.boards.delivered_samples import DeliveredSamples
from hiltest.boards.sample_checks import SampleChecks
from hiltest.errors import DeviceError, HiltestError, ProtocolError, SensorAbsentError
from hiltest.interfaces.quantities import Quantity
from hiltest.link.messages import Select, Sensors
from hiltest.link.ports import SerialPort
from hiltest.link.replies import Identity, SensorInfo, SensorKind
from hiltest.link.request import Request
from hiltest.link.session import Session
from hiltest.link.transcript import Transcript
from hiltest.tape.tape import Tape

_SHIELD_HINT = (
    "Put the FRDM-FXS-MULTI-B shield on the board, or name the present sensors in the rig file. "
    "The identity, cycles and link suites need no sensor: pytest hil/suites -k 'identity or cycles or link'."
)


@dataclass(frozen=True, slots=True)
class LinkTerms:
    """Terms of the link to a board."""

    nonce_seed: int
    """Seed of the nonces of the session."""
    attempts: int
    """Maximum number of attempts per request."""

    def session(
        self,
        opened: Callable[[], SerialPort],
        transcript: Transcript | None,
        tape: Tape,
        *,
        session_type: Callable[..., Session] = Session,
    ) -> Session:
        """Open the session with a present board, or the replayed session."""
        port = tape.port(opened)
        terms: LinkTerms = tape.ask("link", {}, LinkTerms, lambda: self)
        return session_type(port, transcript=transcript, nonce_seed=terms.nonce_seed, attempts=terms.attempts)


class ProtocolInterface:
    """Firmware that answers hiltest's requests: synchronised, identified, its sensors selected.

    Parameters
    ----------
    session
        Over an open port. The interface closes it.
    sensor_names
        Name of the sensor to use for each kind; without a name the first that is present.
    is_noise_free
        Returns whether the true readings of a kind of sensor have no noise, so that equal samples are no fault.
    tape
        Records the errors of `delivered`, or raises the recorded ones.
    delivered
        Returns the checks of replies against delivered samples; None if the board does not see them.

    Attributes
    ----------
    sample_checks : SampleChecks
        Refuses samples that no intact sensor returns; each reply is checked on arrival.

    Raises
    ------
    ProtocolError
        When other firmware answers, or refuses the first requests.
    BenchError
        When nothing answers.
    """

    offers = frozenset(
        {
            Quantity.HEADING,
            Quantity.PITCH,
            Quantity.ROLL,
            Quantity.MAGNETOMETER,
            Quantity.ACCELEROMETER,
            Quantity.GYROSCOPE,
            Quantity.TEMPERATURE,
        }
    )

    def __init__(
        self,
        session: Session,
        sensor_names: Mapping[SensorKind, str],
        is_noise_free: Callable[[SensorKind], bool],
        *,
        tape: Tape,
        delivered: Callable[[Sequence[SensorInfo]], DeliveredSamples] | None = None,
    ) -> None:
        self.session, self._sensor_names = session, sensor_names
        try:
            session.synchronise()
            self.identity: Identity = session.identify()
            self.sensors: tuple[SensorInfo, ...] = self._select()
            self.sample_checks = SampleChecks(lambda kind: self.sensor(kind).name, is_noise_free)
            self._tape, self._delivered = tape, delivered(self.sensors) if delivered else None
            session.on_reply = self._check_reply
        except HiltestError as error:
            session.close()
            if isinstance(error, DeviceError):
                raise ProtocolError(f"the firmware refused the first request: {error}") from error
            raise

    @property
    def clock(self) -> str:
        """``virtual`` or ``wall``."""
        return self.session.clock

    def now_s(self) -> float:
        """Return the time of the board's clock [s]."""
        return self.session.now()

    def sleep(self, seconds: float) -> None:
        """Wait, by the wall clock [s]."""
        time.sleep(seconds)

    @property
    def firmware_line(self) -> str:
        """Name, version and build of the firmware, for people."""
        return f"{self.identity.name} {self.identity.version} build {self.identity.build_id}"

    def sensor(self, kind: SensorKind) -> SensorInfo:
        """Return the selected sensor of a kind.

        Raises
        ------
        SensorAbsentError
            When there is none; the message lists the present sensors and a remedy.
        """
        sensor_name = self._sensor_names.get(kind)
        for sensor in self.sensors:
            # A board without its shield falls back to its own part, which the rig does not ask for.
            if sensor.kind is kind and sensor.selected and sensor.present and sensor_name in (None, sensor.name):
                return sensor
        raise SensorAbsentError(
            sensor_name
            if sensor_name and kind.name.lower() in sensor_name
            else f"{kind.name.lower()} {sensor_name or ''}".strip(),
            [sensor.name for sensor in self.sensors if sensor.present],
            _SHIELD_HINT,
        )

    def _check_reply(self, request: Request[Any], reply: object) -> None:
        # Firmware that repeats a sample is not a sensor that does: the samples of the bus tell the two apart.
        delivered = self._delivered
        self._tape.check("board.delivered", lambda: delivered.check(request, reply) if delivered else None)
        self.sample_checks.reply(reply)

    def close(self) -> None:
        self.session.close()

    def _select(self) -> tuple[SensorInfo, ...]:
        """Select one present sensor of each kind, and query the sensors again."""
        sensors = self.session.request(Sensors())
        for kind in SensorKind:
            sensor_name = self._sensor_names.get(kind)
            for sensor in sensors:
                if sensor.kind is kind and sensor.present and sensor_name in (None, sensor.name):
                    try:
                        self.session.request(Select(sensor.sensor_id))
                    except DeviceError as error:
                        if not error.is_of_sensors:
                            raise
                        # Only tests that need this sensor fail; all others still run.
                    break
        return self.session.request(Sensors())
