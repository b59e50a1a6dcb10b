"""The kinds of device interface by name: those of hiltest, and a user's own by entry point."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import entry_points
from types import MappingProxyType

from hiltest.errors import ConfigError, HiltestError, nearest_hint
from hiltest.interfaces.fsflk import FsflkInterface
from hiltest.interfaces.packets import Release
from hiltest.interfaces.quantities import Observation, PolledInterface, Quantity, StreamInterface
from hiltest.interfaces.text_table import text_interface
from hiltest.rig.device import Device
from hiltest.rig.rig import Rig

#: Group of entry points: each names a callable that takes the rig and returns an interface.
GROUP = "hiltest.device"
_SHOWN_BYTES = 48

Decoder = StreamInterface | PolledInterface
Opener = Callable[[Rig], Decoder]


def _fsflk(rig: Rig) -> Decoder:
    device = _device(rig)
    releases = {str(release): release for release in Release}
    return FsflkInterface(releases[device.fsflk.release], device.fsflk.algorithm)


def _text(rig: Rig) -> Decoder:
    table = _device(rig).text
    assert table is not None  # a rig without it is refused earlier

    def where(key: str) -> str:
        """Return the place of a key of the table, or of the nearest enclosing table."""
        parts = ("device", "text", *key.split("."))
        prefixes = (parts[:depth] for depth in range(len(parts), 0, -1) if ".".join(parts[:depth]) in rig.lines)
        return rig.where(*next(prefixes, parts))

    return text_interface(table, where)


_KINDS: Mapping[str, Opener] = {"fsflk": _fsflk, "text": _text}


def open_interfaces(rig: Rig, of_the_board: Mapping[str, Opener] = MappingProxyType({})) -> dict[str, Decoder]:
    """Return the interfaces of a rig by their kind, in its order.

    Parameters
    ----------
    of_the_board
        Openers of kinds that need the board besides the rig.

    Raises
    ------
    ConfigError
        When no kind has the name, or a source does not offer a quantity.
    """
    device = _device(rig)
    own = {entry_point.name: entry_point for entry_point in entry_points(group=GROUP)}
    kinds = {**_KINDS, **of_the_board}
    interfaces: dict[str, Decoder] = {}
    for kind in device.kinds:
        if kind not in kinds and kind not in own:
            raise ConfigError(
                f"{rig.where('device', 'kind')}: device.kind: no kind {kind!r}; {nearest_hint(kind, [*kinds, *own])}"
            )
        interfaces[kind] = kinds[kind](rig) if kind in kinds else own[kind].load()(rig)
    return interfaces


def feed_decoder(kind: str, decoder: StreamInterface, data: bytes, time_s: float) -> Sequence[Observation]:
    """Decode bytes that have arrived by a time; see `StreamInterface.feed`.

    Raises
    ------
    ConfigError
        When the interface of a user ends with an exception of its own.
    """
    try:
        return decoder.feed(data, time_s)
    except HiltestError:
        raise
    except Exception as error:
        raise ConfigError(
            f"device.kind {kind}: {type(decoder).__qualname__}.feed of {type(decoder).__module__} raises "
            f"{type(error).__name__} ({error}) for the bytes {data[:_SHOWN_BYTES]!r}: "
            "count such bytes in not_understood"
        ) from error


def sources_of(rig: Rig, interfaces: Mapping[str, Decoder]) -> dict[Quantity, str]:
    """Return the kind that gives each quantity.

    Raises
    ------
    ConfigError
        When the rig names an unknown quantity, or a kind that does not offer it.
    """
    sources: dict[Quantity, str] = {}
    for kind, interface in interfaces.items():
        for quantity in interface.offers:
            sources.setdefault(quantity, kind)
    for key, kind in _device(rig).sources.items():
        where = f"{rig.where('device', 'sources', key)}: device.sources.{key}"
        try:
            quantity = Quantity.named(key)
        except KeyError:
            raise ConfigError(f"{where}: {nearest_hint(key, [quantity.key for quantity in Quantity])}") from None
        if quantity not in interfaces[kind].offers:
            raise ConfigError(
                f"{where}: {kind} does not offer it; it offers "
                f"{', '.join(sorted(offer.key for offer in interfaces[kind].offers))}"
            )
        sources[quantity] = kind
    return sources


def _device(rig: Rig) -> Device:
    if rig.device is None:
        raise ValueError(f"rig {rig.name} has no device table")
    return rig.device
