"""The light and the carbon dioxide of a mission file reach its profile."""

import numpy as np
import pytest

from tests.stages.other_logs import read_folder

DRY_M = np.array([16_000.0, 18_000.0, 20_000.0])


@pytest.mark.parametrize(
    ("entries", "factor"),
    [
        # Ciddor 1996, Eq. 2: (n - 1) of dry air by 1 + 0.534e-6 (x_c - 450).
        ({"co2_ppm": 2000.0}, 1.0 + 0.534e-6 * 1550.0),
        # Eq. 1 at 0.45 and 0.55 um: 1e-8 (5792105/(238.0185 - s2) + 167917/(57.362 - s2)).
        ({"wavelength_m": 0.45e-6}, 1.0097025),
    ],
)
def test_the_index_has_the_light_and_the_carbon_dioxide_of_the_mission(mission, entries, factor):
    usual = profile_of(mission)
    mission.config.setdefault("atmosphere", {}).update(entries)
    other = profile_of(mission)
    temperature_k = usual.temperature(DRY_M)
    assert other.temperature(DRY_M) == pytest.approx(temperature_k, rel=1e-7)
    ratio = other.refractivity(DRY_M) / usual.refractivity(DRY_M)
    assert ratio == pytest.approx(factor, rel=3e-5)


def test_the_index_is_that_of_its_name(mission):
    """Gyer 1996, Eq. 13, of dry air."""
    atmosphere = mission.config.setdefault("atmosphere", {})
    atmosphere["index"] = "gyer"
    profile = profile_of(mission)
    pressure_hpa = profile.pressure(DRY_M) / 100.0
    expected = 78.831e-6 * pressure_hpa / profile.temperature(DRY_M)
    assert profile.refractivity(DRY_M) == pytest.approx(expected, rel=3e-5)


def profile_of(mission):
    return read_folder(mission).air.adjustment.profile
