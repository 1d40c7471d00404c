"""Every option of a command has its effect: none is accepted and then ignored."""

import dataclasses
import importlib
import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from tests.helpers import one_line
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.series.profile_series import TimedProfile
from unbend.batch import runs
from unbend.refraction import METHODS

HOUR_NS = 3600 * 10**9


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
        options = (settings.seed, settings.height_above_ground_m, settings.image_noise_px)
        taken.append((out, *options))
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
    arcsec = []
    for radius in (6_371_000, 637_100):
        words = (
            f"angle --atmosphere icao --camera-height 5000 --ground-height 100 --radius {radius}"
        )
        obeyed(*words.split(), "--step", 15, "--csv", out)
        table = pd.read_csv(out)
        assert table["nadir_angle_deg"].tolist() == pytest.approx([0.0, 15.0, 30.0, 45.0, 60.0])
        answer = unbend(*words.split(), "--nadir-angle", 45, "--json")
        arcsec.append(json.loads(answer.out)["r_c_arcsec"])
        assert table["r_c_arcsec"][3] == pytest.approx(arcsec[-1], rel=1e-9)
    ratio = arcsec[1] / arcsec[0]
    assert abs(ratio - 1.0) > 2e-3


def test_profile_at_every_kilometre(obeyed, tmp_path):
    out = tmp_path / "air.csv"
    obeyed(
        "profile",
        "--atmosphere",
        "us1976",
        "--step",
        1000,
        "--csv",
        out,
    )
    heights = pd.read_csv(out)["h_m"]
    assert np.any(np.isclose(heights, 7000.0))
    assert np.allclose(np.diff(heights)[1:-1], 1000.0)


@pytest.mark.parametrize("step", [(), ("--step", 1000)], ids=str)
def test_a_profile_of_a_long_flight_has_all_its_parts(obeyed, monkeypatch, tmp_path, step):
    air, *rest = runs.air_of_mission_or_standard(None, "us1976")
    first = TimedProfile(0, standard_atmosphere("us1976"))
    second = TimedProfile(HOUR_NS, standard_atmosphere("icao"))
    series = dataclasses.replace(air.series, timed_profiles=(first, second))
    long_flight = dataclasses.replace(air, series=series)
    # The air of a long flight without its log.
    monkeypatch.setattr(runs, "air_of_mission_or_standard", lambda *_: (long_flight, *rest))
    out = tmp_path / "air.csv"
    obeyed("profile", "--atmosphere", "us1976", *step, "--csv", out)
    rows = pd.read_csv(out)
    profiles = rows["profile_id"]
    assert profiles.nunique(dropna=False) == 2
    assert set(rows["time_utc"].str[:19]) == {"1970-01-01 00:00:00", "1970-01-01 01:00:00"}


def test_the_help_of_angle_names_every_method(unbend):
    text = one_line(unbend("angle", "--help").out)
    assert ", ".join(METHODS) in text
    assert "[default: spherical]" in text


def test_run_with_force_runs_again(mission, plain_report):
    first = mission.run()
    second = mission.run()
    forced = mission.run("--force")
    assert "nothing to do" not in first.out
    assert "nothing to do" in second.out
    assert "nothing to do" not in forced.out
