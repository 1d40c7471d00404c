"""A pipe in the place of a file is refused: nobody may ever write into it."""

import os

import pytest

from unbend.batch.dask_executor import scheduler_address
from unbend.config.campaign import open_configs
from unbend.config.yaml_text import read_yaml
from unbend.errors import UnbendError
from unbend.tables.observation_files import open_file

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no named pipes")


@pytest.fixture
def pipe(tmp_path):
    path = tmp_path / "pipe.yaml"
    os.mkfifo(path)
    return path


def test_a_pipe_is_no_mission_file(pipe):
    with pytest.raises(UnbendError, match="it is a pipe or a device, not a file"):
        read_yaml(pipe)
    missions, campaigns = open_configs([pipe])
    assert ([mission.path for mission in missions], campaigns) == ([pipe], [])


def test_a_pipe_is_no_table_and_no_file_of_a_scheduler(pipe):
    for kind in ("csv", "colmap", "metashape"):
        with pytest.raises(UnbendError, match=r"^OBS-MISSING: "):
            open_file(pipe, kind)
    with pytest.raises(UnbendError, match=r"^SCHEDULER-FILE: .*it is not a file"):
        scheduler_address(str(pipe))
