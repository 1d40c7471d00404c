"""Every option of a command has its effect: none is accepted and then ignored."""

from __future__ import annotations

import dataclasses
import importlib
import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile
from unbend.batch import runs
from unbend.refraction import METHODS

from .printed import csv_rows_of, one_line


def test_run_with_force_runs_again(mission, plain_report):
    assert "nothing to do" not in mission.run().out
    assert "nothing to do" in mission.run().out
    assert "nothing to do" not in mission.run("--force").out


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ((), (7, 3000.0, 0.0)),
        (("--seed", 11), (11, 3000.0, 0.0)),
        (("--height", 1234.5), (7, 1234.5, 0.0)),
        (("--noise", 0.25), (7, 3000.0, 0.25)),
    ],
    ids=str,
)
def test_options_of_simulate(unbend, monkeypatch, tmp_path, options, expected):
    taken = []

    def simulate(out, settings, progress):
        taken.append((out, settings.seed, settings.height_above_ground_m, settings.image_noise_px))
        progress("rays", 1, 2)
        return SimpleNamespace(
            images=11,
            observation_count=2345,
            points=678,
            duration_s=90.0,
            missions={"bin": out / "bin.yaml"},
        )

    monkeypatch.setattr(importlib.import_module("unbend.simulate"), "simulate", simulate)
    ended = unbend("simulate", tmp_path / "flown", *options)
    assert ended.code == 0
    assert taken == [(tmp_path / "flown", *expected)]
    text = one_line(ended.out)
    assert "11 images, 2,345 observations of 678 points, 90 s of flight in three logs" in text
    assert "unbend run" in text


def test_the_table_and_one_angle_agree_for_another_radius(unbend, tmp_path, obeyed):
    """By two commands; at 45 degrees an earth of a tenth of the radius changes R by a percent."""
    out = tmp_path / "radial.csv"
    heights = ("--atmosphere", "icao", "--camera-height", 5000, "--ground-height", 100)
    arcsec = {}
    for radius in (6_371_000, 637_100):
        obeyed("angle", *heights, "--radius", radius, "--step", 15, "--csv", out)
        table = pd.read_csv(out)
        assert table["nadir_angle_deg"].tolist() == pytest.approx([0.0, 15.0, 30.0, 45.0, 60.0])
        angle = unbend("angle", *heights, "--radius", radius, "--nadir-angle", 45, "--json")
        arcsec[radius] = json.loads(angle.out)["r_c_arcsec"]
        assert table["r_c_arcsec"][3] == pytest.approx(arcsec[radius], rel=1e-9)
    assert abs(arcsec[637_100] / arcsec[6_371_000] - 1.0) > 2e-3


def test_profile_at_every_kilometre(obeyed, tmp_path):
    out = tmp_path / "air.csv"
    obeyed("profile", "--atmosphere", "us1976", "--step", 1000, "--csv", out)
    heights = pd.read_csv(out)["h_m"]
    assert np.any(np.isclose(heights, 7000.0))
    assert np.allclose(np.diff(heights)[1:-1], 1000.0)


@pytest.mark.parametrize("step", [(), ("--step", 1000)], ids=str)
def test_a_profile_of_a_long_flight_has_all_its_parts(obeyed, monkeypatch, tmp_path, step):
    air, samples, ledger = runs.air_of_mission_or_standard(None, "us1976")
    hour_ns = 3600 * 10**9
    parts = (
        TimedProfile(0, standard_atmosphere("us1976")),
        TimedProfile(hour_ns, standard_atmosphere("icao")),
    )
    series = dataclasses.replace(air.series, timed_profiles=parts)
    several = dataclasses.replace(air, series=series)
    monkeypatch.setattr(runs, "air_of_mission_or_standard", lambda *_: (several, samples, ledger))
    out = tmp_path / "air.csv"
    obeyed("profile", "--atmosphere", "us1976", *step, "--csv", out)
    rows = csv_rows_of(out)
    assert len({row["profile_id"] for row in rows}) == 2
    assert {row["time_utc"][:19] for row in rows} == {"1970-01-01 00:00:00", "1970-01-01 01:00:00"}


def test_the_help_of_angle_names_every_method(unbend):
    text = one_line(unbend("angle", "--help").out)
    assert ", ".join(METHODS) in text
    assert "[default: spherical]" in text
