"""The sample flight against its known truth.

The truth comes from `unbend.simulate`: another refractive index (Edlén), rays by the eikonal ODE
on the ellipsoid, hydrostatics by an ODE, another camera model: nothing of the code under test.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml
from scipy.spatial.transform import Rotation

from unbend import correct
from unbend.atmosphere import profile_from_table
from unbend.batch.runs import read_mission
from unbend.config import load_mission
from unbend.geodesy import lambert_gravity
from unbend.refraction import Exposures, correct_observations, ray_table
from unbend.units import ARCSEC, DEGREE

from .conftest import (
    KINDS,
    REPOSITORY,
    read_observations,
    run_sample,
    sample_sections,
)

QUATERNION = ["q_x", "q_y", "q_z", "q_w"]


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


MEASURED = ["x_px", "y_px"]
CORRECTED = ["x_corrected_px", "y_corrected_px"]
TRUE = ["x_true_px", "y_true_px"]


def distance(first, second):
    """Pixels between points (n, 2)."""
    return np.linalg.norm(np.asarray(first) - second.to_numpy(), axis=1)


def profile_of(table, latitude_rad):
    """The simulator's air."""
    return profile_from_table(
        table["h_m"],
        table["temperature_k"],
        table["pressure_pa"],
        table["vapour_pressure_pa"],
        gravity=lambert_gravity(latitude_rad),
    )


@pytest.fixture(scope="module")
def true_profile(truth):
    latitude_deg = float(truth["stations"]["lat_deg"].mean())
    return profile_of(truth["profile"], latitude_deg * DEGREE)


def error_with(profile, stations, truth: dict[str, pd.DataFrame]):
    """Distances of corrected from true points [px]."""
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
    row_of_image = pd.Series(stations.index, stations["image"])
    row = observations["image"].map(row_of_image).to_numpy()
    corrected = np.full((len(observations), 2), np.nan)
    for name, section in mission.cameras.items():
        is_of_camera = observations["image"].str.startswith(name).to_numpy()
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
        corrected[is_of_camera, 0] = corrections.x_corrected_px
        corrected[is_of_camera, 1] = corrections.y_corrected_px
    return distance(corrected, observations[TRUE])


def test_true_profile_and_true_stations_give_true_points(true_profile, truth):
    # Measured: 1.2e-4 px at most, for the two formulas of the refractive index.
    error = error_with(true_profile, truth["stations"], truth)
    assert np.isfinite(error).all()
    assert error.max() < 0.001


@pytest.mark.parametrize("kind", KINDS)
def test_true_profile_and_logged_stations(kind, runs, true_profile, truth):
    stations = pd.read_parquet(runs[kind].output / "stations.parquet")
    assert error_with(true_profile, stations, truth).max() < 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_adjusted_profile_beats_the_standard(kind, runs, truth, tmp_path):
    true = truth["observations"]
    standard_run = run_sample(kind, tmp_path / kind, atmosphere={"adjust": False})

    shift_px = rms(distance(true[MEASURED], true[TRUE]))
    adjusted_px, standard_px = (
        rms(distance(read_observations(run.output)[CORRECTED], true[TRUE]))
        for run in (runs[kind], standard_run)
    )

    assert adjusted_px < 0.03 * shift_px
    assert standard_px > 2.0 * adjusted_px


def test_the_remaining_error_is_the_air(runs, truth):
    """R_c itself, without the window that hides part of it in the nadir images."""
    rows = read_observations(runs["bin"].output)
    true = truth["observations"]
    is_oblique = true["image"].str.startswith("oblique")
    error = rows["r_c_rad"] / true["r_c_rad"] - 1.0
    assert rms(error[is_oblique].to_numpy()) < 0.03


def test_the_three_logs_agree(runs):
    first, *more = (read_observations(run.output)[CORRECTED] for run in runs.values())
    for points in more:
        assert distance(first, points).max() < 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_cabin_air_changes_r_cc_as_the_truth_does(kind, runs, truth):
    true = truth["observations"]
    r_cc = read_observations(runs[kind].output)["r_cc_rad"]
    # R_cc / tan(zeta_f) belongs to the exposure; compare its changes from image to image.
    true_of_image = true["r_cc_rad"].groupby(true["image"])
    per_image = true_of_image.mean()
    assert per_image.std() / per_image.mean() > 0.005, "the cabin is constant: no test"
    ratio = r_cc.groupby(true["image"]).sum() / true_of_image.sum()
    assert np.abs(ratio - 1.0).max() < 0.03
    assert np.abs(r_cc - true["r_cc_rad"]).max() / ARCSEC < 0.1


def test_sample_logs_are_small():
    logs = [Path(sample_sections(kind, Path("out"))["log"]["path"]) for kind in KINDS]
    assert [log.name for log in logs] == [f"flight.{kind}" for kind in KINDS]
    assert sum(log.stat().st_size for log in logs) < 10_000_000


def test_tables_in_memory_give_the_rows_of_the_run(runs):
    """To the last bit, columns of uncertainty included: `correct` with the flight's air."""
    run = runs["bin"].output
    mission = run.with_name("bin.yaml")
    sections = yaml.safe_load(mission.read_text("utf-8"))
    expected = pq.read_table(run / "observations")

    rows = correct(
        pq.read_table(sections["observations"]["path"]),
        pq.read_table(run / "stations.parquet"),
        read_mission(mission).air.series,
        sections["cameras"],
        mount=sections["mount"],
    )

    assert rows.num_rows == 2188
    assert rows.cast(expected.schema).equals(expected)
    manifest = json.loads((run / "manifest.json").read_text("utf-8"))
    for name in ("uncertainty", "cabin_air"):
        text = rows.schema.metadata[f"unbend.{name}".encode()]
        assert json.loads(text) == manifest[name]


def test_the_gallery_shows_this_flight(runs):
    from docs.gallery import sample_flight
    from docs.gallery.plates import numbers_of

    shown = sample_flight.rows(runs["bin"].output)
    assert shown == numbers_of("sample_flight")
    page = (REPOSITORY / "docs/pages/theory/uncertainty.md").read_text("utf-8")
    share = runs["bin"].manifest.values["uncertainty"]["variance_share"]
    assert f"In the sample flight it is {share:.2f}:" in page
