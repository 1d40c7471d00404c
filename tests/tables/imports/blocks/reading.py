"""All that a mission reads of a block, and how a block is refused."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.tables.observed import COLUMNS
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


def rows(path, program):
    """The image points of a block."""
    batches = [batch.to_pandas() for batch in block_rows(path, program)]
    return pd.concat(batches, ignore_index=True)


def places_of(path, program):
    """The places of the object points of a block by their names."""
    names, places = block_reader(program).read_points(path)
    return dict(zip(names.to_pylist(), places, strict=True))


def missed(path, program, places: dict[str, np.ndarray]):
    """(n, 2) by how many pixels points, through poses and the only camera, miss image points."""
    images = read_block_images(path, program)
    turns = Rotation.from_quat(images.angles, scalar_first=True)
    camera = read_camera(path, program, None)
    image_points = rows(path, program)
    image_points = image_points[image_points["point"].isin(places)]
    number_of_image = pd.Series(range(len(images.image)), index=images.image)
    number = number_of_image[image_points["image"]].to_numpy()
    ecef = np.array([places[point] for point in image_points["point"]])
    steps = ecef - images.position[number]
    rays = turns[number].apply(steps)
    x, y, z = rays.T
    projected = np.transpose(camera.project(x / z, y / z))
    return projected - image_points[["x_px", "y_px"]].to_numpy()


def read_everything(path, program):
    """All that a mission reads of a block."""
    reader = block_reader(program)
    with damage_refused(path, program):
        files = reader.block_files(path)
        cameras = list(reader.read_cameras(path))
    assert path.is_dir() or path in files
    for name in cameras or ["1"]:
        read_camera(path, program, name)
    open_observations(
        path,
        COLUMNS,
        None,
        Ledger(),
        file_format=program,
    )
    read_block_images(path, program)


WORDS_OF_LIBRARIES = r"Error|Traceback|codec|unpack|literal|NoneType|object has|0x|sqlite3"


def refusal(path, program):
    """What a mission says that cannot read a block, without a word of Python or of a library."""
    with pytest.raises(InputError) as caught:
        read_everything(path, program)
    text = str(caught.value)
    assert not re.search(WORDS_OF_LIBRARIES, text)
    return text
