"""The correction of a table of observations from a file to a file, for the benchmarks.

Not in `survey.py`, whose import belongs to what `bench_start.py` times.
"""

from dataclasses import asdict
from pathlib import Path

import numpy as np
from survey import CAMERA, air, image_names, uncertainty

from unbend.batch.run_files import PartsOfRun, correct_into
from unbend.batch.store import open_folder
from unbend.messages import Ledger
from unbend.refraction import Exposures
from unbend.refraction.ray import rays_by
from unbend.stages.correction_setup import CorrectionSetup
from unbend.stages.ground_heights import GivenGround, TerrainGround
from unbend.tables.manifest.whole import Manifest
from unbend.tables.observations import open_observations

BATCH_ROWS = 250_000
COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}


def correct_table(
    source: Path,
    out: Path,
    exposures: Exposures,
    ground: GivenGround | TerrainGround,
    height_column: str | None,
) -> dict[str, int]:
    """What a run does to the observations, sigmas and all, without the log and the air.

    Returns how many rows have each status.
    """
    count = exposures.usable.size
    setup = CorrectionSetup(
        images=image_names(count),
        camera_names=np.full(count, "nadir", object),
        exposures=exposures,
        ground=ground,
        cameras={"nadir": CAMERA},
        rays=(rays_by(air(), "spherical"),),
        profile_number=np.zeros(count, np.int64),
        uncertainties=(uncertainty(exposures),),
    )
    observations = open_observations(source, COLUMNS, height_column, Ledger())
    with open_folder(out) as folder:
        statistics = correct_into(
            PartsOfRun(folder),
            observations,
            setup,
            batch_rows=BATCH_ROWS,
            metadata={},
        )
        outputs = [asdict(output) for output in folder.outputs()]
        folder.commit(Manifest({"outputs": outputs}))
    return statistics.status
