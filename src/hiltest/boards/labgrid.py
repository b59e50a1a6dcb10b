"""A place of labgrid as a board: acquired while its port is open, its serial port reached through its exporter.

hiltest calls the command ``labgrid-client``, so labgrid may be installed in its own environment, and its settings for
coordinators and users (``LG_COORDINATOR``, ``LG_USERNAME``) apply.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote

from hiltest.errors import BenchError, ConfigError, PortRefusedError
from hiltest.text import legible

SCHEME = "labgrid://"
_ANSWER_S = 30.0  # a coordinator answers at once, or not at all; a power cycle waits for some seconds
_INSTALL = "pip install 'hiltest[labgrid]', or put the labgrid-client of another environment on the PATH"


@dataclass(frozen=True, slots=True)
class LabgridPlace:
    """A place of labgrid."""

    name: str
    power_cycle: bool = False
    """True if it is switched off and on again before its port is opened."""
    options: str = ""
    """Options of pyserial's RFC 2217 client, such as ``ign_set_control``; empty for none."""

    def acquire(self) -> bool:
        """Acquire the place; return False if the user had acquired it already, and so keeps it.

        Raises
        ------
        PortRefusedError
            If somebody else has acquired it.
        BenchError
            If the coordinator does not answer, or has no such place.
        """
        done = self._client("acquire")
        if done.returncode == 0:
            return True
        message = _last_line(done.stderr or done.stdout)
        if "already acquired place" in message and "To work simultaneously" not in message:
            return False
        if "is already acquired by" in message or "already acquired place" in message:
            raise PortRefusedError(f"{SCHEME}{self.name}", message, "Wait until it is released, or take another place.")
        raise self._error(message)

    def release(self) -> None:
        """Release the place."""
        done = self._client("release")
        if done.returncode:
            raise self._error(_last_line(done.stderr or done.stdout))

    def cycle(self) -> None:
        """Switch its power off and on again, by the power resource that it has."""
        done = self._client("power", "cycle")
        if done.returncode:
            raise self._error(_last_line(done.stderr or done.stdout))

    def port(self) -> str:
        """Return the URL of its serial port.

        Raises
        ------
        BenchError
            If it has none, or more than one.
        """
        import yaml

        done = self._client("env")
        if done.returncode:
            raise self._error(_last_line(done.stderr or done.stdout))
        try:
            (target,) = yaml.safe_load(done.stdout)["targets"].values()
            resources = [(kind, resource[kind]) for resource in target["resources"] for kind in resource]
            ports = [parameters for kind, parameters in resources if kind == "NetworkSerialPort"]
            urls = [_url(parameters) for parameters in ports]
        except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
            raise BenchError(f"cannot parse labgrid's answer about place {self.name}: {error!r}") from error
        if len(urls) != 1:
            kinds = ", ".join(kind for kind, _ in resources) or "nothing"
            raise BenchError(
                f"place {self.name} has {len(urls)} exported serial ports (of: {kinds}), and a board needs one. "
                "Match only the board's port: labgrid-client -p PLACE add-match"
            )
        return urls[0] + (f"?{self.options}" if self.options else "")

    def _client(self, *command: str) -> subprocess.CompletedProcess[str]:
        program = _program()
        try:
            return subprocess.run(
                [program, "-p", self.name, *command],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_ANSWER_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise BenchError(f"labgrid does not answer within {_ANSWER_S:.0f} s: is LG_COORDINATOR right?") from error

    def _error(self, message: str) -> BenchError:
        return BenchError(f"labgrid: place {self.name}: {message}. labgrid-client -p {self.name} show has details")


def place_of(url: str) -> LabgridPlace:
    """Parse ``labgrid://PLACE`` or ``labgrid://PLACE?power=cycle``; other options are for pyserial.

    Raises
    ------
    ConfigError
        If it names no place.
    """
    text, _, query = url.partition("://")[2].partition("?")
    name = unquote(text).strip("/")
    if not name or name.startswith("-") or not name.isprintable():
        raise ConfigError(f"port {url!r}: write the name of a place: {SCHEME}bench-3")
    query_options = parse_qs(query, keep_blank_values=True)
    power = query_options.pop("power", [])
    if power not in ([], ["cycle"]):
        raise ConfigError(f"port {url!r}: power must be cycle, not {power[-1]!r}")
    options = "&".join(f"{key}={value}" if value else key for key, values in query_options.items() for value in values)
    return LabgridPlace(name, bool(power), options)


def _program() -> str:
    beside = Path(sys.executable).with_name("labgrid-client")
    program = shutil.which("labgrid-client") or (str(beside) if beside.is_file() else None)
    if program is None:
        raise ConfigError(f"labgrid-client is not installed: {_INSTALL}")
    return program


def _url(parameters: Any) -> str:
    host = str(parameters["host"])
    if (protocol := parameters.get("protocol", "rfc2217")) != "rfc2217":
        raise BenchError(f"labgrid exports this port as {protocol}, which sets no baud rate; export it as rfc2217")
    port = int(parameters["port"])
    return f"rfc2217://[{host}]:{port}" if ":" in host else f"rfc2217://{host}:{port}"


def _last_line(output: str) -> str:
    lines = [line for line in output.splitlines() if line.strip()]
    return legible(lines[-1].strip()).rstrip(".") if lines else "it says nothing"
