"""Position and attitude between samples: closed forms, and scipy's Slerp."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from pipeline.flight.channels import Channel, Source
from pipeline.flight.trajectory import (
    GAP_IN_CHANNEL,
    INSIDE,
    OUTSIDE_CHANNEL,
    bracket,
    interpolate,
    interpolate_attitude,
    interpolate_position,
)

SECOND = 1_000_000_000


def channel(seconds: list[float], boot: list[int] | None = None, **columns: object) -> Channel:
    time_ns = (np.array(seconds) * SECOND).astype(np.int64)
    arrays = {name: np.asarray(values, np.float64) for name, values in columns.items()}
    boots = np.array(boot if boot is not None else [0] * len(seconds), np.int16)
    return Channel("X", time_ns, arrays, Source("X"), boots)


def at(*seconds: float) -> np.ndarray:
    return (np.array(seconds) * SECOND).astype(np.int64)


def test_linear_between_samples_and_exact_on_them() -> None:
    x = channel([0, 1, 2], value=[0.0, 10.0, 40.0])
    assert interpolate(x, "value", at(0, 0.25, 1, 1.5, 2), 1.0).tolist() == [0, 2.5, 10, 25, 40]


def test_nothing_outside_the_log() -> None:
    x = channel([0, 1, 2], value=[0.0, 10.0, 40.0])
    assert np.isnan(interpolate(x, "value", at(-0.001, 2.001), 1.0)).all()
    assert bracket(x, at(-0.001, 2.001), 1.0).coverage.tolist() == [OUTSIDE_CHANNEL] * 2


def test_nothing_in_a_gap_but_its_edges_stand() -> None:
    x = channel([0, 0.1, 0.2, 0.3, 9.0, 9.1], value=range(6))
    found = bracket(x, at(0.3, 0.31, 5.0, 8.99, 9.0), 1.0).coverage
    assert found.tolist() == [INSIDE, GAP_IN_CHANNEL, GAP_IN_CHANNEL, GAP_IN_CHANNEL, INSIDE]
    assert np.isnan(interpolate(x, "value", at(5.0), 1.0)).all()


def test_the_limit_is_the_limit_but_slow_air_sensors_have_their_own() -> None:
    x = channel([0, 2, 4, 6], value=range(4))
    assert bracket(x, at(3.0), 1.0).coverage.tolist() == [GAP_IN_CHANNEL]
    assert x.gap_limit_s(1.0) == 6.0
    assert bracket(x, at(3.0), x.gap_limit_s(1.0)).coverage.tolist() == [INSIDE]


def test_a_restart_is_a_gap_however_short() -> None:
    x = channel([0, 0.1, 0.2, 0.3], boot=[0, 0, 1, 1], value=range(4))
    coverage = bracket(x, at(0.05, 0.15, 0.25), 1.0).coverage
    assert coverage.tolist() == [INSIDE, GAP_IN_CHANNEL, INSIDE]


def test_an_empty_channel_and_a_missing_column() -> None:
    assert np.isnan(interpolate(channel([]), "value", at(0.0), 1.0)).all()
    assert np.isnan(interpolate(channel([0, 1], value=[0, 1]), "other", at(0.5), 1.0)).all()
    assert bracket(channel([]), at(0.0), 1.0).coverage.tolist() == [OUTSIDE_CHANNEL]


def test_longitude_across_the_180th_meridian() -> None:
    x = channel([0, 1], lat_rad=[0.3, 0.3], lon_rad=np.radians([179.9999, -179.9999]))
    latitude, longitude, _ = interpolate_position(x, at(0.25, 0.5, 0.75), 2.0)
    degrees = np.degrees(longitude) % 360.0
    assert np.allclose(degrees, [179.99995, 180.0, 180.00005], rtol=0, atol=1e-9)
    assert np.allclose(latitude, 0.3, rtol=0, atol=1e-12)


def test_position_over_the_pole() -> None:
    x = channel([0, 1], lat_rad=np.radians([89.9999, 89.9999]), lon_rad=np.radians([10, 190.0]))
    latitude, _, _ = interpolate_position(x, at(0.5), 2.0)
    assert np.degrees(latitude[0]) == pytest.approx(90.0, abs=1e-7)


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.floats(-np.pi, np.pi), min_size=6, max_size=6),
    st.lists(st.floats(0.0, 1.0), min_size=1, max_size=5),
)
def test_attitude_agrees_with_scipys_slerp(angles: list[float], when: list[float]) -> None:
    both = Rotation.from_euler("ZYX", np.array(angles).reshape(2, 3))
    q = both.as_quat()
    x = channel([0, 1], q_x=q[:, 0], q_y=q[:, 1], q_z=q[:, 2], q_w=q[:, 3])
    found, _ = interpolate_attitude(x, at(*when), 2.0)
    instants = at(*when) / SECOND
    expected = Slerp([0, 1], both)(instants)
    turned = expected.inv() * Rotation.from_quat(found[:, [1, 2, 3, 0]])
    if (both[0].inv() * both[1]).magnitude() < np.pi - 1e-3:  # else either way is right
        assert turned.magnitude().max() < 1e-7
    assert (found[:, 0] >= 0.0).all()


def test_quaternions_of_either_sign_are_the_same_attitude() -> None:
    q = Rotation.from_euler("Z", [[0.1], [0.3]]).as_quat()
    signed = q * np.array([[1.0], [-1.0]])
    x = channel([0, 1], q_x=signed[:, 0], q_y=signed[:, 1], q_z=signed[:, 2], q_w=signed[:, 3])
    found, _ = interpolate_attitude(x, at(0.5), 2.0)
    assert Rotation.from_quat(found[0, [1, 2, 3, 0]]).as_euler("ZYX")[0] == pytest.approx(0.2)


def test_no_attitude_from_zeros_or_nan() -> None:
    x = channel([0, 1, 2], q_x=[0, 0, 0], q_y=[0, 0, 0], q_z=[0, np.nan, 0], q_w=[1, 1, 0])
    found, _ = interpolate_attitude(x, at(0.5, 1.5), 2.0)
    assert np.isnan(found).all()
