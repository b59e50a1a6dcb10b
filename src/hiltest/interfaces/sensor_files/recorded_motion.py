"""The recording of a rig, placed in virtual time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hiltest.budgets import PACKETS, TABLE
from hiltest.errors import ConfigError
from hiltest.interfaces.packet_stream import batches
from hiltest.interfaces.packet_summary import BoardClock, summary_of
from hiltest.interfaces.packets import AxisConvention, MainPacket
from hiltest.interfaces.sensor_files.parsed_lines import UTF16_MARKS
from hiltest.interfaces.sensor_files.tracks import Recorded, read_table, rotate_to_body
from hiltest.json_files import read_bounded, read_pieces
from hiltest.orientation.motion_recording import read_motion_recording
from hiltest.rig import Rig
from hiltest.rig.recorded_motion import PlaybackFile, PlayedSensor
from hiltest.world.recorded_motion import Playback, Resampling, Sensed, Track

#: Time of a first reading without its own time [s]: firmware has configured its sensors and runs by then.
START_S = 3.0
_LOOKED_AT = 4096
# Plausible range of the median of a recording's readings, under any motion and magnetisation; outside, the unit must be
# wrong. The earth's field is 22 to 66 uT, and the parts' axes end at 1200; nothing is shaken at 3 g for long.
_PLAUSIBLE = {Sensed.MAGNETOMETER: (5.0, 2100.0), Sensed.ACCELEROMETER: (0.3, 3.0), Sensed.GYROSCOPE: (0.0, 4000.0)}
# Attributes of the packet, in their units.
_OF_PACKET = {Sensed.MAGNETOMETER: "field_ut", Sensed.ACCELEROMETER: "acceleration_g", Sensed.GYROSCOPE: "rate_dps"}


def load_playback(rig: Rig) -> Playback | None:
    """Read the recording that a rig names; None if it names none.

    Raises
    ------
    ConfigError
        When it cannot be read or interpreted.
    """
    playback = rig.world.playback if rig.world else None
    if playback is None:
        return None
    try:
        return read_playback(rig.path.parent / playback.file, playback)
    except ConfigError as error:
        raise ConfigError(f"{rig.where('world', 'playback')}: world.playback: {error}") from error


def read_playback(path: Path, settings: PlaybackFile) -> Playback:
    """Read a recording by a rig's table, and place it in virtual time.

    Raises
    ------
    ConfigError
        When it cannot be read or interpreted; the message has the file, and the line of a table.
    """
    begin = next(read_pieces(path, TABLE, otherwise="give a recording"), b"")[:_LOOKED_AT]
    if path.suffix == ".npz":
        return placed(path.name, _read_archive(path, settings), settings)
    # Packets contain zero bytes, UTF-8 text does not.
    is_stream = b"\0" in begin and path.suffix != ".gz" and not _is_utf16(begin)
    recorded = _read_packets(path, settings) if is_stream else read_table(path, settings)
    for sensed, track in recorded.tracks.items():
        _refuse_implausible(path, sensed, track)
    return placed(path.name, recorded, settings)


def _is_utf16(start: bytes) -> bool:
    """Return whether a file with this start is UTF-16 text; a truncated stream may also begin with its mark."""
    return start.startswith(UTF16_MARKS) and "\n" in start.decode("utf-16", errors="replace")


def placed(name: str, recorded: Recorded, settings: PlaybackFile) -> Playback:
    """Return a recording in virtual time, by a rig's table."""
    first_s = min(float(track.times_s[0]) for track in recorded.tracks.values())
    if settings.start_s is None and recorded.clock_began_s is not None:
        shift_s = recorded.clock_began_s
    else:
        shift_s = (START_S if settings.start_s is None else settings.start_s) - first_s
    tracks = {sensed: Track(track.times_s + shift_s, track.readings) for sensed, track in recorded.tracks.items()}
    return Playback(name, tracks, Resampling(settings.resampling), recorded.notes, recorded.motion)


def _refuse_implausible(path: Path, sensed: Sensed, track: Track) -> None:
    low, high = _PLAUSIBLE[sensed]
    middle = float(np.median(np.linalg.norm(track.readings, axis=1)))
    if not low <= middle <= high:
        raise ConfigError(
            f"{path}: its {sensed.key} reads {middle:.4g} {sensed.unit} in the median, and {low:g} to "
            f"{high:g} is what one can: say the right unit with world.playback.{sensed.key}.unit"
        )


def _read_archive(path: Path, settings: PlaybackFile) -> Recorded:
    """Read a motion with its true attitude, whose sensors have the axes of the body."""
    if settings != PlaybackFile(settings.file, settings.start_s, settings.resampling):
        raise ConfigError(f"{path}: units, axes and times of an archive are fixed; leave file, start_s and resampling")
    motion = read_motion_recording(path)
    times_s = np.arange(len(motion.movement)) / motion.rate_hz
    readings = {
        Sensed.MAGNETOMETER: motion.field_ut,
        Sensed.ACCELEROMETER: motion.gravity_g,
        Sensed.GYROSCOPE: np.degrees(motion.gyroscope_rad_s),
    }
    return Recorded({sensed: Track(times_s, values) for sensed, values in readings.items()}, motion=motion)


def _read_packets(path: Path, settings: PlaybackFile) -> Recorded:
    """Read the main packets of a stream: accelerometer, calibrated magnetometer, uncalibrated gyroscope."""
    data = read_bounded(path, PACKETS, otherwise="give a recording")
    _, release = summary_of(data)
    rows = [table for batch in batches(data, release) for table in batch.tables if table.kind is MainPacket]
    if not rows:
        raise ConfigError(f"{path}: neither a text table nor packets of NXP's sensor fusion with readings")
    frames = {flags >> 4 & 3 for table in rows for flags in np.unique(table.rows["flags"]).tolist()}
    default = PlayedSensor().axes
    if frames != {AxisConvention.NED.value} and any(settings.sensor(sensed.key).axes == default for sensed in Sensed):
        raise ConfigError(
            f"{path}: its packets are not in the frame NED; say with axes, under [world.playback."
            "magnetometer], accelerometer and gyroscope, how each lies in the body"
        )
    clock = BoardClock()
    times_s = np.array([clock.advance(stamp) for table in rows for stamp in table.rows["time_us"].tolist()])
    if clock.resets or bool((np.diff(times_s) <= 0.0).any()):
        raise ConfigError(f"{path}: the board's clock goes back in it, or stands; cut the recording there")
    tracks = {}
    for sensed, attribute in _OF_PACKET.items():
        readings = np.concatenate([table.scaled_values(attribute) for table in rows])
        is_present = readings.any(axis=1)  # the firmware sends zeros for a sensor that the algorithm does not use
        if is_present.any():
            in_axes = rotate_to_body(readings[is_present], settings.sensor(sensed.key).signed_axes)
            tracks[sensed] = Track(times_s[is_present], in_axes)
    if not tracks:
        raise ConfigError(f"{path}: its packets show no reading of any sensor")
    return Recorded(tracks)
