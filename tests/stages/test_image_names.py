"""Images called otherwise than their exposures: proposed, refused, taken where that is stated."""

from __future__ import annotations

import pyarrow as pa
import pytest

from unbend.batch.runs import read_mission
from unbend.errors import MissionError


def rename(mission, new) -> None:
    table = mission.measurements()
    names = [new(name) for name in table["image"].to_pylist()]
    mission.observe(table.set_column(table.column_names.index("image"), "image", pa.array(names)))


def test_other_names_are_refused_with_the_proposal_and_taken_when_stated(mission):
    plain = read_mission(mission.save()).stations
    rename(mission, lambda name: f"run/{name.replace('_000', '').upper()}.TIF")
    with pytest.raises(MissionError) as caught:
        read_mission(mission.save())
    assert caught.value.code == "IMAGES-OTHER"
    assert "[case, extension, folder, digits]" in caught.value.what
    mission.config["observations"]["match_names"] = ["case", "extension", "folder", "digits"]
    prepared = read_mission(mission.save())
    assert prepared.stations.ok.all()
    assert prepared.stations.time_ns.tolist() == plain.time_ns.tolist()
    assert sorted(prepared.stations.image) == list(prepared.observations.images)
    assert {entry.code for entry in prepared.ledger} >= {"IMAGES-RENAMED"}


def test_one_name_in_another_case_is_a_loss_that_says_so(mission):
    first = mission.measurements()["image"][0].as_py()
    rename(mission, lambda name: name.upper() if name == first else name)
    prepared = read_mission(mission.save())
    (entry,) = [entry for entry in prepared.ledger if entry.code == "IMAGES-UNMATCHED"]
    assert entry.count == 1
    assert "match_names: [case]" in entry.what
