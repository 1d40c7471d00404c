"""Images called otherwise than their exposures: proposed, refused, taken where that is stated."""

from tests.helpers import with_code
from tests.stages.other_logs import read_folder, refusal_to_read


def rename(mission, new_name):
    table = mission.measured_rows()
    table["image"] = table["image"].map(new_name)
    mission.observe_rows(table)


def in_a_folder(name):
    """As another program calls nadir_00001."""
    number = name.replace("_000", "").upper()
    return f"run/{number}.TIF"


def test_other_names_are_refused_with_the_proposal_and_taken_when_stated(mission):
    plain = read_folder(mission).stations
    rename(mission, in_a_folder)
    text = refusal_to_read(mission, "IMAGES-OTHER")
    assert "[case, extension, folder, digits]" in text

    mission.config["observations"]["match_names"] = [
        "case",
        "extension",
        "folder",
        "digits",
    ]
    prepared = read_folder(mission)
    assert prepared.stations.ok.all()
    assert prepared.stations.time_ns.tolist() == plain.time_ns.tolist()
    assert sorted(prepared.stations.image) == list(prepared.observations.images)
    assert with_code(prepared.ledger, "IMAGES-RENAMED")


def test_one_name_in_another_case_is_a_loss_that_says_so(mission):
    first = mission.measurements()["image"][0].as_py()
    rename(mission, lambda name: name.replace(first, first.upper()))
    ledger = read_folder(mission).ledger
    (unmatched,) = with_code(ledger, "IMAGES-UNMATCHED")
    assert unmatched.count == 1
    assert "match_names: [case]" in unmatched.what
