"""The sample flight against its known truth.

The truth comes from `unbend.simulate`: another refractive index (Edlén), rays by the eikonal ODE
on the ellipsoid, hydrostatics by an ODE, another camera model: nothing of the code under test.
"""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests.physics.ray_on_sphere import ray_angle_sphere
from unbend import correct
from unbend.atmosphere import Profile, profile_from_table
from unbend.atmosphere.refractive_index import IndexModel
from unbend.batch.runs import read_mission
from unbend.config import load_mission
from unbend.geodesy import lambert_gravity
from unbend.refraction import Exposures, bend, correct_observations, ray_table
from unbend.units import ARCSEC, DEGREE

from .conftest import REPOSITORY, read_observations, run_sample

Array = NDArray[np.float64]
QUATERNION = ["q_x", "q_y", "q_z", "q_w"]


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def distance(first: pd.DataFrame, second: pd.DataFrame, names: tuple[str, str]) -> Array:
    """Pixels between the corrected points of a run and those of another table."""
    return np.hypot(
        first["x_corrected_px"] - second[names[0]], first["y_corrected_px"] - second[names[1]]
    ).to_numpy()


@pytest.fixture(scope="module")
def true_profile(truth) -> Profile:
    table = truth["profile"]
    gravity = lambert_gravity(float(truth["stations"]["lat_deg"].mean()) * DEGREE)
    return profile_from_table(
        table["h_m"],
        table["temperature_k"],
        table["pressure_pa"],
        table["vapour_pressure_pa"],
        gravity=gravity,
    )


def correct_with(
    profile: Profile, stations: pd.DataFrame, truth: dict[str, pd.DataFrame]
) -> tuple[Array, Array]:
    """Distances of corrected from true points, and sizes of the true shifts [px]."""
    mission = load_mission(REPOSITORY / "configs" / "sample_bin.yaml")
    observations = truth["observations"]
    table = ray_table(profile)
    stations = stations.reset_index(drop=True)
    outside = profile.refractivity(stations["h_msl_m"])
    inside = profile.index.refractivity(
        stations["cabin_temperature_k"],
        stations["cabin_pressure_pa"],
        stations["cabin_vapour_pressure_pa"],
    )
    exposures = Exposures(
        np.ones(len(stations), bool),
        Rotation.from_quat(stations[QUATERNION]).as_matrix(),
        stations["lat_deg"].to_numpy() * DEGREE,
        stations["h_msl_m"].to_numpy(),
        outside,
        inside,
    )
    row = observations["image"].map(pd.Series(stations.index, stations["image"])).to_numpy()
    error = np.full(len(observations), np.nan)
    for name, section in mission.cameras.items():
        is_of_camera = (observations["image"].str.startswith(name)).to_numpy()
        part = observations[is_of_camera]
        corrections = correct_observations(
            part["x_px"].to_numpy(),
            part["y_px"].to_numpy(),
            part["h_g_m"].to_numpy(),
            row[is_of_camera],
            exposures,
            camera=section.interior_orientation,
            table=table,
        )
        error[is_of_camera] = np.hypot(
            corrections.x_corrected_px - part["x_true_px"],
            corrections.y_corrected_px - part["y_true_px"],
        )
    shift = np.hypot(
        observations["x_px"] - observations["x_true_px"],
        observations["y_px"] - observations["y_true_px"],
    )
    return error, shift.to_numpy()


def test_true_profile_and_true_stations_give_true_points(true_profile, truth):
    # Measured: 1.2e-4 px at most, for the two formulas of the refractive index.
    error, _ = correct_with(true_profile, truth["stations"], truth)
    assert np.isfinite(error).all()
    assert error.max() < 0.001


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_true_profile_and_logged_stations(kind, runs, true_profile, truth):
    stations = pd.read_parquet(runs[kind].output / "stations.parquet")
    error, _ = correct_with(true_profile, stations, truth)
    assert error.max() < 0.01


@pytest.mark.parametrize("kind", ["bin", "tlog", "mcap"])
def test_adjusted_profile_beats_the_standard(kind, runs, truth, tmp_path, capsys):
    true = truth["observations"]
    shift = np.hypot(true["x_px"] - true["x_true_px"], true["y_px"] - true["y_true_px"])
    adjusted = rms(distance(read_observations(runs[kind].output), true, ("x_true_px", "y_true_px")))
    standard_run = run_sample(kind, tmp_path / kind, atmosphere={"adjust": False})
    standard = rms(
        distance(read_observations(standard_run.output), true, ("x_true_px", "y_true_px"))
    )
    size = rms(shift.to_numpy())
    with capsys.disabled():
        print(
            f"\n{kind}: rms error of the shift {100 * adjusted / size:.2f} % adjusted, "
            f"{100 * standard / size:.2f} % with us1976"
        )
    assert adjusted < 0.03 * size
    assert standard > 2.0 * adjusted


def test_the_remaining_error_is_the_air(runs, truth):
    """R_c itself, without the window that hides part of it in the nadir images."""
    rows = read_observations(runs["bin"].output)
    true = truth["observations"]
    oblique = true["image"].str.startswith("oblique").to_numpy()
    error = rows["r_c_rad"][oblique] / true["r_c_rad"][oblique] - 1.0
    assert rms(error.to_numpy()) < 0.03


def test_the_three_logs_agree(runs):
    tables = [read_observations(run.output) for run in runs.values()]
    for table in tables[1:]:
        assert distance(tables[0], table, ("x_corrected_px", "y_corrected_px")).max() < 0.01


def test_cabin_air_changes_r_cc_as_the_truth_does(runs, truth):
    true = truth["observations"]
    for run in runs.values():
        rows = read_observations(run.output)
        # R_cc / tan(zeta_f) belongs to the exposure; compare its changes from image to image.
        by_image = pd.DataFrame(
            {"image": true["image"], "found": rows["r_cc_rad"], "true": true["r_cc_rad"]}
        ).groupby("image")
        ratio = by_image["found"].sum() / by_image["true"].sum()
        per_image = by_image["true"].mean()
        assert per_image.std() / per_image.mean() > 0.005, "the cabin is constant: no test"
        assert np.abs(ratio - 1.0).max() < 0.03
        assert np.abs(rows["r_cc_rad"] - true["r_cc_rad"]).max() / ARCSEC < 0.1


def test_kernel_against_the_ode_on_the_true_profile(truth, capsys):
    """The ray kernel and the ODE through the very same air, layers of 50 m with an inversion."""
    table = truth["profile"]
    table = table[table["h_m"] % 50.0 == 0.0]
    air = profile_from_table(
        table["h_m"],
        table["temperature_k"],
        table["pressure_pa"],
        table["vapour_pressure_pa"],
        gravity=lambert_gravity(0.83),
    )
    breaks = air.break_heights_m
    inside = tuple(breaks[(breaks > 412.0) & (breaks < 3450.0)])

    def index(h: float) -> float:
        return 1.0 + float(air.refractivity(h))

    worst = 0.0
    for zeta in (0.2, 45.0, 75.0, 85.0):
        bent, _ = bend(
            ray_table(air),
            3450.0,
            412.0,
            np.sin(zeta * DEGREE),
            np.cos(zeta * DEGREE),
            radius=6.38e6,
        )
        expected = ray_angle_sphere(index, 3450.0, 412.0, zeta * DEGREE, 6.38e6, breaks=inside)
        worst = max(worst, abs(float(bent) - expected) / ARCSEC)
    with capsys.disabled():
        print(f"\nkernel against ODE on the true profile: {worst:.1e} arcsec")
    assert worst < 1e-6


def test_refractive_indices_agree(true_profile, truth):
    """Our Ciddor against the simulator's Edlén over the true air: 1e-7 of n."""
    table = truth["profile"]
    low = table["h_m"] < 4000.0
    refractivity = true_profile.refractivity(table["h_m"][low])
    assert np.abs(refractivity - table["refractivity"][low]).max() < 1e-7
    assert IndexModel().name == "ciddor"


def test_sample_logs_are_small():
    logs = [REPOSITORY / "sample_logs" / f"flight.{kind}" for kind in ("bin", "tlog", "mcap")]
    assert sum(log.stat().st_size for log in logs) < 10_000_000
    for kind in ("bin", "tlog", "mcap"):
        sections = yaml.safe_load((REPOSITORY / "configs" / f"sample_{kind}.yaml").read_text())
        assert (REPOSITORY / "configs" / sections["log"]["path"]).is_file()


def test_tables_in_memory_give_the_rows_of_the_run(runs):
    """To the last bit, columns of uncertainty included: `correct` with the flight's air."""
    run = runs["bin"].output
    mission = runs["bin"].output.parent / "bin.yaml"
    sections = yaml.safe_load(mission.read_text(encoding="utf-8"))
    expected = pa.concat_tables(
        pq.read_table(part) for part in sorted((run / "observations").glob("part-*.parquet"))
    )
    rows = correct(
        pq.read_table(sections["observations"]["path"]),
        pq.read_table(run / "stations.parquet"),
        read_mission(mission).air.series,
        sections["cameras"],
        mount=sections["mount"],
    )
    assert rows.num_rows == 2188
    assert rows.cast(expected.schema).equals(expected)
    manifest = json.loads((run / "manifest.json").read_text(encoding="utf-8"))
    for name in ("uncertainty", "cabin_air"):
        assert json.loads(rows.schema.metadata[f"unbend.{name}".encode()]) == manifest[name]


def test_the_gallery_shows_this_flight(runs):
    from docs.gallery import sample_flight
    from docs.gallery.plates import numbers_of

    shown = sample_flight.rows(runs["bin"].output)
    assert shown == numbers_of("sample_flight")
    page = (REPOSITORY / "docs/pages/theory/uncertainty.md").read_text(encoding="utf-8")
    manifest = json.loads((runs["bin"].output / "manifest.json").read_text(encoding="utf-8"))
    share = manifest["uncertainty"]["variance_share"]
    assert f"In the sample flight it is {share:.2f}:" in page
