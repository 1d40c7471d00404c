"""All that a mission reads of a block, and how a block is refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from unbend.errors import InputError
from unbend.messages import Ledger
from unbend.tables.imports.blocks import (
    block_reader,
    block_rows,
    damage_refused,
    read_block_images,
    read_camera,
)
from unbend.tables.observations import open_observations

SHARED = Path(__file__).resolve().parents[5] / "shared" / "ba"
OPENSFM = Path(__file__).resolve().parents[3] / "data" / "opensfm"
COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}


def rows(path: Path, program: str) -> pd.DataFrame:
    """The image points of a block."""
    return pd.concat([b.to_pandas() for b in block_rows(path, program)], ignore_index=True)


def places_of(path: Path, program: str) -> dict[str, np.ndarray]:
    """The places of the object points of a block by their names."""
    names, places = block_reader(program).read_points(path)
    return dict(zip(names.to_pylist(), places, strict=True))


def missed(path: Path, program: str, places: dict[str, np.ndarray]) -> np.ndarray:
    """(n, 2) by how many pixels points, through poses and the only camera, miss image points."""
    images = read_block_images(path, program)
    turns = Rotation.from_quat(images.angles, scalar_first=True)
    camera = read_camera(path, program, None)
    image_points = rows(path, program)
    image_points = image_points[image_points["point"].isin(places)]
    number = pd.Series(range(len(images.image)), index=images.image)
    of_image = number[image_points["image"]].to_numpy()
    ecef = np.array([places[point] for point in image_points["point"]])
    x, y, z = turns[of_image].apply(ecef - images.position[of_image]).T
    projected = np.stack(camera.project(x / z, y / z), axis=1)
    return projected - image_points[["x_px", "y_px"]].to_numpy()


def read_everything(path: Path, program: str) -> None:
    """All that a mission reads of a block."""
    with damage_refused(path, program):
        files = block_reader(program).block_files(path)
        cameras = list(block_reader(program).read_cameras(path))
    assert path.is_dir() or path in files
    for name in cameras or ["1"]:
        read_camera(path, program, name)
    open_observations(path, COLUMNS, None, Ledger(), file_format=program)
    read_block_images(path, program)


WORDS_OF_LIBRARIES = r"Error|Traceback|codec|unpack|literal|NoneType|object has|0x|sqlite3"


def refusal(path: Path, program: str) -> str:
    """What a mission says that cannot read a block, without a word of Python or of a library."""
    with pytest.raises(InputError) as caught:
        read_everything(path, program)
    text = str(caught.value)
    assert not re.search(WORDS_OF_LIBRARIES, text)
    return text
