"""Recordings with an optical truth: the arrays of an archive, and archives that are none."""

from __future__ import annotations

import io
import math
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hiltest.errors import ConfigError
from hiltest.orientation.motion_recording import MotionRecording, read_motion_recording
from hiltest.orientation.quaternions import pose_of, rotation_ned_from_body

COUNT = 6


def arrays() -> dict[str, np.ndarray]:
    """Return a sound recording: two samples at rest, three of motion, and one that no camera saw."""
    quaternion = np.tile(np.float32([0.5, 0.5, -0.5, 0.5]), (COUNT, 1))
    quaternion[5] = np.nan
    return {
        "gyroscope_rad_s": np.arange(3 * COUNT, dtype=np.float32).reshape(COUNT, 3),
        "accelerometer_m_s2": np.tile(np.float32([0.0, 0.0, 9.8]), (COUNT, 1)),
        "magnetometer_ut": np.tile(np.float32([20.0, 0.0, -40.0]), (COUNT, 1)),
        "quaternion_enu": quaternion,
        "movement": np.array([False, False, True, True, True, False]),
        "sampling_rate_hz": np.array(100.0),
    }


def written(path: Path, **changes: np.ndarray | None) -> Path:
    content = {name: array for name, array in (arrays() | changes).items() if array is not None}
    np.savez_compressed(path, **content)
    return path


def test_arrays_come_out_in_the_units_and_frames_of_the_package(tmp_path: Path):
    recording = read_motion_recording(written(tmp_path / "trial.npz"))
    assert (recording.name, recording.rate_hz) == ("trial.npz", 100.0)
    assert recording.gyroscope_rad_s.tolist() == arrays()["gyroscope_rad_s"].tolist()
    assert recording.movement.tolist() == [False, False, True, True, True, False]
    assert np.isnan(recording.truth[5]).all()
    # The matrix of a quaternion, written out: its rows are east, north and up in the body frame.
    w, x, y, z = 0.5, 0.5, -0.5, 0.5
    to_enu = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    east, north, up = to_enu
    assert rotation_ned_from_body(recording.truth[0]) == pytest.approx(np.array([north, east, -up]), abs=1e-12)


def test_between_samples_the_truth_turns_evenly_and_is_unknown_beside_an_unseen_one(tmp_path: Path):
    angles_rad = np.array([0.0, 0.1, 0.2, 0.3, 0.4, np.nan])
    scalar_first = np.stack([np.cos(angles_rad / 2), 0 * angles_rad, 0 * angles_rad, np.sin(angles_rad / 2)], axis=1)
    scalar_first[1] *= -1.0  # the same attitude
    recording = read_motion_recording(written(tmp_path / "trial.npz", quaternion_enu=scalar_first.astype(np.float32)))
    truth = recording.truth_at(np.array([-1.0, 0.005, 0.0125, 0.039, 0.045]))
    # Up turns to up, so from east-north-up to north-east-down an angle counts the other way, and from north on.
    headings_rad = [pose_of(attitude).heading_deg * np.pi / 180.0 for attitude in truth[:4]]
    # A chord of 0.1 rad is divided evenly: of an angle's third power, 1e-3, a 250th is left out.
    assert np.pi / 2.0 - np.array(headings_rad) == pytest.approx([0.0, 0.05, 0.125, 0.39], abs=4e-6)
    assert np.isnan(truth[4]).all()


def test_the_bias_is_the_mean_rate_before_the_motion(tmp_path: Path):
    assert read_motion_recording(written(tmp_path / "a.npz")).rest_bias_rad_s().tolist() == [1.5, 2.5, 3.5]
    moving = read_motion_recording(written(tmp_path / "b.npz", movement=np.ones(COUNT, dtype=bool)))
    with pytest.raises(ConfigError, match=r"b\.npz: no rest before the motion"):
        moving.rest_bias_rad_s()


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"magnetometer_ut": None}, "the array magnetometer_ut is missing"),
        (
            {"gyroscope_rad_s": np.zeros((COUNT, 4))},
            r"gyroscope_rad_s has shape \(6, 4\) and type float64; expected rows",
        ),
        ({"gyroscope_rad_s": np.zeros((COUNT, 3), dtype=int)}, "gyroscope_rad_s has shape .* int64; expected"),
        ({"gyroscope_rad_s": np.asfortranarray(np.zeros((COUNT, 3)))}, "gyroscope_rad_s has shape"),
        ({"movement": np.zeros(COUNT)}, "movement has shape .* truth values"),
        ({"movement": np.zeros(COUNT, dtype=bool)}, "movement is False everywhere"),
        ({"movement": np.ones(5, dtype=bool)}, "the arrays have different lengths: gyroscope_rad_s 6, .*movement 5"),
        ({"sampling_rate_hz": np.array(0.0)}, "sampling_rate_hz is 0; expected 1 to 100000"),
        ({"sampling_rate_hz": np.array(math.nan)}, "sampling_rate_hz is nan"),
        ({"sampling_rate_hz": np.array([100.0])}, r"sampling_rate_hz has shape \(1,\)"),
        ({"magnetometer_ut": np.full((COUNT, 3), np.nan)}, "magnetometer_ut has values that are not finite"),
        ({"quaternion_enu": np.full((COUNT, 4), np.nan)}, "quaternion_enu has no attitude during the motion"),
        ({"quaternion_enu": np.ones((COUNT, 4))}, "quaternion_enu has rows whose norm is not 1"),
        ({"movement": np.array([object()] * COUNT)}, "movement has shape .* object"),
        ({name: array[:0] for name, array in arrays().items() if array.ndim}, "gyroscope_rad_s has 0 rows"),
    ],
)
def test_a_fault_is_named_with_its_array(tmp_path: Path, changes: dict[str, np.ndarray | None], fault: str):
    with pytest.raises(ConfigError, match=rf"^trial\.npz: {fault}"):
        read_motion_recording(written(tmp_path / "trial.npz", **changes))


@pytest.mark.parametrize(
    ("announced", "actual", "fault"),
    [
        (10**9, 0, "has 1000000000 rows; expected 1 to 3600000"),
        (3_000_000, 0, "has not the 36000000 bytes"),
        (COUNT, COUNT - 1, "has not the 72 bytes"),
        (COUNT, COUNT + 1, "has not the 72 bytes"),
    ],
)
def test_an_array_of_another_size_than_its_header_announces_is_refused(
    tmp_path: Path, announced: int, actual: int, fault: str
):
    """Nothing of the announced size is allocated; a header of more than 3.6 million rows is refused unread."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (announced, 3)})
    path = tmp_path / "trial.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in arrays().items():
            content = io.BytesIO()
            np.lib.format.write_array(content, array)
            resized = header.getvalue() + bytes(12 * actual)
            archive.writestr(f"{name}.npy", resized if name == "gyroscope_rad_s" else content.getvalue())
    with pytest.raises(ConfigError, match=f"gyroscope_rad_s {fault}"):
        read_motion_recording(path)


def test_a_file_that_is_missing_or_no_archive_is_a_wrong_argument(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"absent\.npz: not a readable NumPy archive"):
        read_motion_recording(tmp_path / "absent.npz")
    (tmp_path / "text.npz").write_text("time,x,y,z\n")
    with pytest.raises(ConfigError, match=r"text\.npz: not a readable NumPy archive"):
        read_motion_recording(tmp_path / "text.npz")
    with zipfile.ZipFile(tmp_path / "other.npz", "w") as archive:
        archive.writestr("sampling_rate_hz.npy", b"no array")
    with pytest.raises(ConfigError, match="sampling_rate_hz is not a NumPy array"):
        read_motion_recording(tmp_path / "other.npz")


@given(st.data())
@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_damaged_archives_are_refused_or_read_and_nothing_else(tmp_path: Path, data: st.DataObject):
    content = bytearray(written(tmp_path / "sound.npz").read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged.npz"
    path.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    try:
        assert isinstance(read_motion_recording(path), MotionRecording)
    except ConfigError as error:
        assert str(error).startswith("damaged.npz: ")  # noqa: PT017 (the message is the point)
