"""The light and the carbon dioxide of a mission file reach its profile."""

from __future__ import annotations

import pyarrow.parquet as pq
import pytest


def profile_of(mission) -> dict[str, list[float]]:
    ended = mission.run()
    assert ended.code == 0, ended.text
    (path,) = mission.folder.rglob("profile.parquet")
    return pq.read_table(path).to_pydict()


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
    assert other["temperature_k"] == pytest.approx(usual["temperature_k"], abs=1e-9)
    high = [i for i, h in enumerate(usual["h_m"]) if h > 15_000.0]  # dry
    assert len(high) > 3
    for i in high:
        ratio = other["refractivity"][i] / usual["refractivity"][i]
        assert ratio == pytest.approx(factor, rel=3e-5)
