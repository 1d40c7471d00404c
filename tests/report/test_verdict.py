"""What a run means and what to do next, from the manifests of runs that went well or wrong."""

import numpy as np
import pytest
import yaml

from tests.helpers import one_line
from unbend.report.concerns import steps_of_losses
from unbend.report.summary import next_steps, outcome, remarks
from unbend.stages.messages import flight_of_unknown_hour

from .manifests import manifest_of

READY = "). Ready for bundle adjustment"
LOOK = "). Check "


def verdict_of(values):
    return outcome(manifest_of(values))


def remarks_of(values):
    return remarks(manifest_of(values))


def steps_of(values):
    return next_steps(manifest_of(values))


def run_to_verdict(mission, code):
    """Manifest, verdict and next steps of a run, which the terminal prints too."""
    ended = mission.run()
    assert ended.code == code, ended.text
    manifest = mission.manifest()
    steps = " ".join(steps_of(manifest))
    verdict = verdict_of(manifest)
    printed = one_line(ended.out)
    assert verdict in printed
    assert steps in printed
    return manifest, verdict, steps


def with_heights(mission, heights):
    """Give the ground heights of the measurements as a function of those simulated."""
    table = mission.measured_rows()
    table["h_g_m"] = heights(table["h_g_m"])
    mission.observe_rows(table)


def test_all_corrected(baseline):
    manifest = baseline.manifest()
    text = verdict_of(manifest)
    assert text.startswith("All 59 observations were corrected by ")
    assert text.endswith(f"{READY}.")
    steps = steps_of(manifest)
    assert steps[-1] == (
        "Switch off the refraction correction of the adjustment program: never correct twice."
    )
    assert not any("suspect" in step or "Leave out" in step for step in steps)


def test_some_flagged_and_none_corrected(mission, plain_report):
    with_heights(mission, lambda h: h.where(h.index >= 2))
    _, text, steps = run_to_verdict(mission, 3)
    assert text.startswith("57 of 59 observations were corrected by ")
    assert text.endswith(f"{READY} without the other 2 rows.")
    assert steps.startswith("Leave out 2 rows without new coordinates (2 no_ground);")
    with_heights(mission, lambda h: h + np.nan)
    _, text, steps = run_to_verdict(mission, 3)
    assert text.startswith("None of 59 observations could be corrected: 59 no_ground")
    assert "djust" not in steps
    assert "correct the mission file, run again" in steps


def test_a_likely_mistake_is_not_ready(mission, plain_report):
    """Heights in feet: every observation gets a correction, and none may be used."""
    with_heights(mission, lambda h: h * 3.28084)
    manifest, text, steps = run_to_verdict(mission, 3)
    assert manifest["observations"]["status"]["ok"] == 59
    kinds = {entry["code"]: entry["kind"] for entry in manifest["ledger"]}
    assert kinds["PLAUSIBLE-GROUND"] == "finding"
    assert READY not in text
    assert text.endswith(f"{LOOK}1 likely mistake (PLAUSIBLE-GROUND) before use.")
    assert steps.startswith("Correct the cause of PLAUSIBLE-GROUND")


def test_air_that_was_not_measured(mission, baseline, plain_report):
    """By a standard without a standard deviation, and by a climatology with one."""
    mission.config["atmosphere"] = {"adjust": False}
    for camera in mission.config["cameras"].values():
        camera["window"] = None
    for role in ("pressure", "temperature", "humidity"):
        mission.config["log"]["channels"].pop(f"cabin_{role}")
    manifest, text, steps = run_to_verdict(mission, 0)
    (remark,) = remarks_of(manifest)
    assert remark == "The air was not measured: a standard atmosphere is used instead."
    assert text.endswith(f"{READY}.")
    assert "For a better correction, remove atmosphere.adjust: false" in steps
    assert "thermometer" not in steps
    manifest = baseline.manifest()
    manifest["profile"]["basis"] = "climatology"
    manifest["uncertainty"]["scale_sigma"] = 0.0412
    steps = " ".join(steps_of(manifest))
    assert "For a better correction, give a thermometer" in steps
    assert (
        "a climatology is used instead, the correction is known to ± 4.1 % of the refraction R."
        in remarks_of(manifest)[0]
    )


def test_a_correction_too_small_to_matter(baseline):
    """One of 1.1 px, made 30 times smaller; not said where many rows could not be corrected."""
    manifest = baseline.manifest()
    for shift in ("shift_px", "shift_ground_m"):
        manifest["correction"][shift]["maximum"] /= 30.0
    assert verdict_of(manifest).endswith("), too small to measure: not needed here.")
    assert any("difference is not measurable" in step for step in steps_of(manifest))
    manifest["correction"]["shift_px"]["count"] = 40
    assert "not needed" not in verdict_of(manifest)


CABINS = yaml.safe_load("""
- [0.05, 0.012, '5 % of the refraction R, the air outside of 1.2 % only.']
- [0.021, 0.13, '2.1 % of the refraction R, the air outside of 13 %.']
- [0.03, null, '3 % of the refraction R.']
- [0.02, 0.01, null]
- [null, 0.01, null]
""")


@pytest.mark.parametrize(("cabin", "air", "end"), CABINS)
def test_the_cabin_is_in_it_from_two_percent_on(baseline, cabin, air, end):
    manifest = baseline.manifest()
    manifest["cabin_sigma_share"]["median"] = cabin
    manifest["uncertainty"] = None if air is None else {"scale_sigma": air}
    assert "cabin" not in verdict_of(manifest)
    if end is None:
        assert remarks_of(manifest) == []
    else:
        text = f"The air in the cabin causes a median uncertainty of {end}"
        assert remarks_of(manifest) == [text]
        assert (
            "The sigma of the sensors in the cabin is assumed to be 3 hPa, 1 K. If it is "
            "smaller, give sigma_pressure_hpa, sigma_temperature_k (cameras.nadir.window.cabin, "
            "cameras.oblique.window.cabin)."
        ) in steps_of(manifest)


def test_the_air_in_the_lens_comes_before_the_cabin_and_the_air_outside(baseline):
    """What it leaves is as large as refraction; the cabin makes 5 % of R uncertain."""
    manifest = baseline.manifest()
    manifest["cabin_sigma_share"]["median"] = 0.05
    manifest["profile"]["basis"] = "climatology"
    camera = manifest["air_at_cameras"]["nadir"]
    camera |= {"lens_removed": False, "lens_edge_px": 0.9, "lens_ppm": -103.0}
    beginnings = [step.split(",")[0] for step in steps_of(manifest)]
    assert beginnings[:3] == [
        "State the air of the calibration",
        "For a better correction",
        "The sigma of the sensors in the cabin is assumed to be 3 hPa",
    ]


def test_a_typical_lens_is_named_beside_the_cabin(baseline):
    """Better sensors in the cabin would not help: the unknown part of the lens is larger."""
    manifest = baseline.manifest()
    manifest["cabin_sigma_share"]["median"] = 0.066
    manifest["uncertainty"] = {"scale_sigma": 0.028}
    camera = manifest["air_at_cameras"]["nadir"]
    camera["lens_removed"] = True
    camera["lens_sigma_ppm"] = 24.0
    assert remarks_of(manifest) == [
        "The air in the cabin and the unknown part of a typical lens (24 ppm of the principal "
        "distance) cause a median uncertainty of 6.6 % of the refraction R, the air outside of "
        "2.8 % only."
    ]
    steps = steps_of(manifest)
    assert (
        "If the change of the lens by the air was measured, state dc_dp_px_per_hpa and "
        "dc_dt_px_per_k (cameras.nadir.principal_distance)."
    ) in steps
    assert not any("sensors in the cabin" in step for step in steps)


def test_the_unknown_part_of_a_typical_lens_is_said_where_it_can_be_measured(baseline):
    """Also without a window, where the share of the cabin's angles is zero."""
    manifest = baseline.manifest()
    manifest["cabin_sigma_share"]["median"] = 0.0
    camera = manifest["air_at_cameras"]["nadir"]
    size = {"lens_ppm": -157.0, "lens_sigma_ppm": 39.25, "lens_height_m": 0.48}
    camera |= {"lens_removed": True, "lens_edge_px": 0.201} | size
    assert remarks_of(manifest) == [
        "The corrections contain the air in the lens of nadir, as in a typical lens: "
        "157 ± 39 ppm of the principal distance, 0.2 px outward at the edge of the image; its "
        "unknown part is 12 cm of height (1 sigma)."
    ]
    camera["lens_ppm"] = 157.0
    assert "0.2 px inward" in remarks_of(manifest)[0]
    assert any("state dc_dp_px_per_hpa" in step for step in steps_of(manifest))
    camera["lens_ppm"] = -157.0
    camera["lens_edge_px"] = 0.199
    assert remarks_of(manifest) == []


def test_the_hour_of_the_flight_is_asked_for_where_it_is_unknown(baseline):
    manifest = baseline.manifest()
    assert not any("State the time" in step for step in steps_of(manifest))
    message = flight_of_unknown_hour(where="mission.date", date="2025-06-12")
    manifest["ledger"].append(message.row())
    assert "State the time of the flight too (mission.date): the air is more certain." in steps_of(
        manifest
    )


def test_the_cabin_is_to_be_measured_only_where_it_was_not(baseline):
    manifest = baseline.manifest()
    manifest["cabin_sigma_share"]["median"] = 0.05

    def step():
        (step_of_cabin,) = (text for text in steps_of(manifest) if "window.cabin" in text)
        return step_of_cabin

    cameras = manifest["config"]["cameras"]
    cameras["nadir"]["window"]["cabin"] = "standard_schedule"
    question = "Measure the air in the cabin, or state it: cameras.nadir.window.cabin."
    assert step() == question
    cabin = yaml.safe_load("""
    pressure: log
    pressure_hpa: null
    temperature_c: null
    relative_humidity: null
    sigma_pressure_hpa: 1.0
    sigma_temperature_k: null
    """)
    cameras["nadir"]["window"]["cabin"] = cabin
    cameras["oblique"]["window"]["shape"] = "spherical"
    assert step().startswith("The sigma of the sensors in the cabin is assumed to be 1 K. ")
    assert step().endswith("give sigma_temperature_k (cameras.nadir.window.cabin).")
    cabin["sigma_temperature_k"] = 0.5
    assert "more accurately than stated" in step()
    missing = {"kind": "fallback", "code": "CABIN-TEMPERATURE", "what": "", "where": "camera nadir"}
    manifest["ledger"].append(missing)
    assert step() == question


CABIN_OF_NUMBERS = yaml.safe_load("""
pressure: 820
pressure_hpa: null
temperature_c: 21
relative_humidity: null
sigma_pressure_hpa: null
sigma_temperature_k: null
""")


@pytest.mark.parametrize(
    ("stated", "keys"),
    [
        ({}, "sigma_pressure_hpa, sigma_temperature_k"),
        ({"pressure": None, "pressure_hpa": 820}, "sigma_pressure_hpa, sigma_temperature_k"),
        ({"sigma_pressure_hpa": 2.0}, "sigma_temperature_k"),
        ({"pressure": "log"}, "sigma_temperature_k"),
        ({"temperature_c": None}, "sigma_pressure_hpa"),
        ({"temperature_c": "log"}, "sigma_pressure_hpa"),
        ({"sigma_pressure_hpa": 2.0, "sigma_temperature_k": 1.0}, None),
    ],
)
def test_numbers_of_a_cabin_without_sigmas_are_named(baseline, stated, keys):
    manifest = baseline.manifest()
    manifest["config"]["cameras"]["nadir"]["window"]["cabin"] = CABIN_OF_NUMBERS | stated
    steps = [step for step in steps_of(manifest) if step.startswith("State the sigmas")]
    expected = []
    if keys is not None:
        where = f"cameras.nadir.window.cabin: {keys}"
        expected = [
            f"State the sigmas of the air in the cabin ({where}): the sigmas of the results do not "
            "contain the errors of these numbers."
        ]
    assert steps == expected


def test_numbers_of_a_cabin_need_no_sigmas_where_the_air_is_less_certain(baseline):
    manifest = baseline.manifest()
    manifest["config"]["cameras"]["nadir"]["window"]["cabin"] = CABIN_OF_NUMBERS
    of_nadir = manifest["correction"]["cameras"]["nadir"]
    by_window = of_nadir["window_arcsec"]["median"]
    by_air = of_nadir["refraction_arcsec"]["median"]

    def has_step():
        return any(step.startswith("State the sigmas") for step in steps_of(manifest))

    manifest["uncertainty"]["scale_sigma"] = 0.9 * by_window / by_air
    assert has_step()
    manifest["uncertainty"]["scale_sigma"] = 1.1 * by_window / by_air
    assert not has_step()
    manifest["uncertainty"] = None
    assert not has_step()


@pytest.mark.parametrize(("kind", "noun"), [("loss", "1 loss"), ("finding", "1 likely mistake")])
def test_nothing_that_ended_with_three_is_ready(baseline, kind, noun):
    """Of the losses only those of single rows, which have no coordinates, leave the rest ready."""
    manifest = baseline.manifest()
    manifest["ledger"] += [{"kind": kind, "code": "LOG-BAD-BYTES", "what": "77 bytes"}] * 2
    text = verdict_of(manifest)
    assert READY not in text
    assert text.endswith(f"{LOOK}{noun} (LOG-BAD-BYTES) before use.")


@pytest.mark.parametrize(
    ("codes", "step"),
    [
        (["LOG-CRC"], "Check which data was lost (LOG-CRC). If there is a complete file, use it."),
        (["OBS-REPEATED-POINT"], "OBS-REPEATED-POINT: Correct the table or block."),
        (["AIR-SOURCE-FAR"], "AIR-SOURCE-FAR: Give a report or sounding of the same day"),
        (["OBS-BEYOND-GRAZING"], "OBS-BEYOND-GRAZING: Give slant ranges"),
        (
            ["AIR-STUCK", "LOG-CRC"],
            "(LOG-CRC). If there is a complete file, use it. AIR-STUCK: Check the sensor",
        ),
        (["OF-TOMORROW"], "See the ledger about OF-TOMORROW."),
    ],
)
def test_the_remedy_of_a_loss_is_that_of_its_code(codes, step):
    text = " ".join(steps_of_losses(codes))
    assert step in text
    is_of_log = "LOG-CRC" in codes
    assert ("complete file" in text) is is_of_log


def test_many_losses_are_left_to_the_ledger():
    codes = ["AIR-STUCK", "DEM-OUTSIDE", "EVENTS-LOST", "GEOID-OUTSIDE", "TIME-STRAY"]
    *explained, last = steps_of_losses(codes)
    assert len(explained) == 3
    assert last == "See the ledger about GEOID-OUTSIDE, TIME-STRAY."


def test_an_incomplete_log_is_no_mistake(baseline):
    """Messages that the link lost: another concern than a mistake, and one that can be accepted."""
    manifest = baseline.manifest()
    lost = {"kind": "finding", "code": "LOG-LINK-LOSS", "what": "the log is incomplete: 9 messages"}
    manifest["ledger"] += [lost, {**lost, "code": "LOG-GAP"}]
    text = verdict_of(manifest)
    assert text.endswith(f"{LOOK}an incomplete log (LOG-GAP, LOG-LINK-LOSS) before use.")
    assert "mistake" not in text
    assert any("accept LOG-GAP, LOG-LINK-LOSS" in s for s in steps_of(manifest))


def test_a_published_method_is_not_for_work(baseline):
    manifest = baseline.manifest()
    manifest["config"]["refraction"]["method"] = "gyer1996"
    assert verdict_of(manifest).endswith(
        "the method gyer1996 (published, for comparison) before use."
    )
