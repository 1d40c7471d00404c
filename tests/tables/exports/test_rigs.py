"""Rigs and frames of COLMAP's databases come out as they went in."""

import sqlite3
from contextlib import closing
from importlib import resources
from types import SimpleNamespace

import numpy as np
import pytest

from unbend.messages import Ledger
from unbend.tables.exports.colmap_rigs import rig_tables

SCHEMA = resources.files("unbend.tables.exports").joinpath("colmap_4_2.sql")
POSE = np.array([0.9, 0.1, 0.2, 0.3, 0.2, -0.1, 0.0]).tobytes()


def exported(names, cameras):
    """What of an exported block rigs rest on."""
    numbers = np.array(cameras)
    return SimpleNamespace(
        image=np.array(names, object),
        camera=numbers,
        cameras=dict.fromkeys(range(max(cameras) + 1)),
    )


# Three frames of a rig of cameras 7 and 9, with an inertial sensor; camera 8 is alone.
SOURCE = f"""
INSERT INTO images VALUES (11, 'a0', 7), (12, 'b0', 9), (13, 'a1', 7), (14, 'b1', 9);
INSERT INTO images VALUES (15, 'a2', 7), (16, 'c', 8), (17, 'b2', 9);
INSERT INTO rigs VALUES (3, 7, 0), (4, 8, 0);
INSERT INTO rig_sensors VALUES (3, 9, 0, x'{POSE.hex()}'), (3, 1, 1, NULL);
INSERT INTO frames VALUES (21, 3), (22, 3), (23, 3), (24, 4);
INSERT INTO frame_data VALUES (21, 11, 7, 0), (21, 12, 9, 0), (22, 13, 7, 0), (22, 14, 9, 0);
INSERT INTO frame_data VALUES (23, 15, 7, 0), (23, 17, 9, 0), (24, 16, 8, 0);
"""


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "source.db"
    with closing(sqlite3.connect(path)) as database:
        database.executescript(SCHEMA.read_text("utf-8") + SOURCE)
    return path


def test_a_rig_keeps_its_sensors_and_frames(source):
    """Images and cameras have other numbers here; b2 is left out, and c is alone."""
    block = exported(
        ["c", "b1", "a1", "a0", "b0", "a2"],
        [0, 1, 2, 2, 1, 2],
    )
    ledger = Ledger()

    tables = rig_tables(block, source, ledger)

    assert tables["rigs"] == [(1, 3, 0), (2, 1, 0)]
    assert tables["rig_sensors"] == [(1, 2, 0, POSE)]
    assert tables["frames"] == [(1, 1), (2, 1), (3, 1), (4, 2)]
    assert tables["frame_data"] == [
        (1, 4, 3, 0),
        (1, 5, 2, 0),
        (2, 2, 2, 0),
        (2, 3, 3, 0),
        (3, 6, 3, 0),
        (4, 1, 1, 0),
    ]
    (message,) = ledger
    assert message.code == "EXPORT-RIGS"
    assert message.kind == "note"
    assert message.what == "1 rig of several cameras is kept, with 3 frames"


@pytest.mark.parametrize(
    ("images", "cameras", "rigs"),
    [
        pytest.param(
            ["b0", "b1", "c"],
            [0, 0, 1],
            [(1, 1, 0), (2, 2, 0)],
            id="its reference is left out",
        ),
        pytest.param(
            ["a0", "b0"],
            [0, 0],
            [(1, 1, 0)],
            id="its cameras are one in the mission",
        ),
    ],
)
def test_a_rig_that_cannot_be_kept_is_said(source, images, cameras, rigs):
    block = exported(images, cameras)
    ledger = Ledger()

    tables = rig_tables(block, source, ledger)

    assert tables["rigs"] == rigs
    assert "rig_sensors" not in tables
    assert len(tables["frames"]) == len(images)
    (message,) = ledger
    assert message.code == "EXPORT-RIGS"
    assert message.kind == "warning"


def test_without_a_source_every_image_is_a_frame():
    block = exported(["a", "b", "c"], [0, 1, 0])
    tables = rig_tables(block, None, Ledger())
    assert tables["rigs"] == [(1, 1, 0), (2, 2, 0)]
    assert tables["frames"] == [(1, 1), (2, 2), (3, 1)]
    assert tables["frame_data"] == [(1, 1, 1, 0), (2, 2, 2, 0), (3, 3, 1, 0)]
