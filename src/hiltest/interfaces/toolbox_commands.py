"""Commands of the Sensor Fusion Toolbox to the firmware: four characters, without terminator or answer."""

from __future__ import annotations

from enum import Enum

from hiltest.interfaces.packets import Release


class ToolboxCommand(Enum):
    """A command by its name; the value is the transmitted text."""

    RATE_PACKETS_ON = b"VG+ "
    RATE_PACKETS_OFF = b"VG- "
    DEBUG_PACKETS_ON = b"DB+ "
    DEBUG_PACKETS_OFF = b"DB- "
    ANGLES_PACKETS_ON = b"RPC+"
    ANGLES_PACKETS_OFF = b"RPC-"
    ALTITUDE_PACKETS_ON = b"ALT+"
    ALTITUDE_PACKETS_OFF = b"ALT-"
    # Select the algorithm of the packets; one that the build does not contain has no effect.
    ACCELEROMETER = b"Q3  "
    MAGNETOMETER = b"Q3M "
    GYROSCOPE = b"Q3G "
    ACCELEROMETER_MAGNETOMETER = b"Q6MA"
    ACCELEROMETER_GYROSCOPE = b"Q6AG"
    NINE_AXES = b"Q9  "
    #: Reset of the fusion and the magnetic calibration; in release 7 also of the accelerometer's.
    RESET = b"RST "
    ZERO_DISPLACEMENT = b"RINS"
    SAVE_ALL_CALIBRATIONS = b"SVAC"
    SAVE_MAGNETIC_CALIBRATION = b"SVMC"
    SAVE_GYROSCOPE_CALIBRATION = b"SVYC"
    SAVE_ACCELEROMETER_CALIBRATION = b"SVGC"
    ERASE_ALL_CALIBRATIONS = b"ERAC"
    ERASE_MAGNETIC_CALIBRATION = b"ERMC"
    ERASE_GYROSCOPE_CALIBRATION = b"ERYC"
    ERASE_ACCELEROMETER_CALIBRATION = b"ERGC"
    # Turn the filter's orientation, to watch it recover.
    PERTURB_X_180 = b"180X"
    PERTURB_Y_180 = b"180Y"
    PERTURB_Z_180 = b"180Z"
    PERTURB_X_MINUS_90 = b"M90X"
    PERTURB_X_PLUS_90 = b"P90X"
    PERTURB_Y_MINUS_90 = b"M90Y"
    PERTURB_Y_PLUS_90 = b"P90Y"
    PERTURB_Z_MINUS_90 = b"M90Z"
    PERTURB_Z_PLUS_90 = b"P90Z"
    # Average the accelerometer for its calibration.
    AVERAGE_AT_LOCATION_0 = b"PA00"
    AVERAGE_AT_LOCATION_1 = b"PA01"
    AVERAGE_AT_LOCATION_2 = b"PA02"
    AVERAGE_AT_LOCATION_3 = b"PA03"
    AVERAGE_AT_LOCATION_4 = b"PA04"
    AVERAGE_AT_LOCATION_5 = b"PA05"
    AVERAGE_AT_LOCATION_6 = b"PA06"
    AVERAGE_AT_LOCATION_7 = b"PA07"
    AVERAGE_AT_LOCATION_8 = b"PA08"
    AVERAGE_AT_LOCATION_9 = b"PA09"
    AVERAGE_AT_LOCATION_10 = b"PA10"
    AVERAGE_AT_LOCATION_11 = b"PA11"

    def is_known_to(self, release: Release) -> bool:
        """Return whether a release has the command.

        The commands of 5.00 are assumed to be those of 4.22, because the source of its receiver is not public.
        """
        return release is Release.V7 or self in _OF_ALL_RELEASES


_ALL = tuple(ToolboxCommand)
_OF_ALL_RELEASES = frozenset(_ALL[: _ALL.index(ToolboxCommand.RESET) + 1])
