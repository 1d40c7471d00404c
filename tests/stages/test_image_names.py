"""Images called otherwise than their exposures: proposed, refused, taken where that is stated."""

from __future__ import annotations

import pyarrow as pa

from tests.helpers import refused, with_code
from unbend.batch.runs import read_mission


def rename(mission, new) -> None:
    table = mission.measurements().to_pandas()
    table["image"] = table["image"].map(new)
    mission.observe(pa.Table.from_pandas(table, preserve_index=False))


def test_other_names_are_refused_with_the_proposal_and_taken_when_stated(mission):
    plain = read_mission(mission.save()).stations
    rename(mission, lambda name: f"run/{name.replace('_000', '').upper()}.TIF")
    with refused("IMAGES-OTHER") as refusal:
        read_mission(mission.save())
    assert "[case, extension, folder, digits]" in refusal.value.what
    mission.config["observations"]["match_names"] = ["case", "extension", "folder", "digits"]
    prepared = read_mission(mission.save())
    assert prepared.stations.ok.all()
    assert prepared.stations.time_ns.tolist() == plain.time_ns.tolist()
    assert sorted(prepared.stations.image) == list(prepared.observations.images)
    assert with_code(prepared.ledger, "IMAGES-RENAMED")


def test_one_name_in_another_case_is_a_loss_that_says_so(mission):
    first = mission.measurements()["image"][0].as_py()
    rename(mission, lambda name: name.upper() if name == first else name)
    (unmatched,) = with_code(read_mission(mission.save()).ledger, "IMAGES-UNMATCHED")
    assert unmatched.count == 1
    assert "match_names: [case]" in unmatched.what
