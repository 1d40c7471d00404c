"""What a run may take away in its folder, and what not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline.batch.store import find_damage, open_folder, read_manifest
from pipeline.errors import StorageError


def commit(folder: Path, *names: str) -> None:
    with open_folder(folder) as run:
        for name in names:
            run.place(name).write_text(name, encoding="utf-8")
            run.seal(name)
        run.commit({"fingerprint": "f", "mission": "m", "exit_code": 0, "outputs": run.outputs()})


def test_files_of_the_user_stay(tmp_path: Path) -> None:
    commit(tmp_path, "observations/part-00000.parquet", "observations/part-00001.parquet")
    (tmp_path / "observations" / "notes.txt").write_text("mine", encoding="utf-8")
    (tmp_path / "observations" / "sub").mkdir()
    commit(tmp_path, "observations/part-00000.parquet")
    left = sorted(p.name for p in (tmp_path / "observations").iterdir())
    assert left == ["notes.txt", "part-00000.parquet", "sub"]


def test_a_refused_run_does_not_make_a_folder_ours(tmp_path: Path) -> None:
    with open_folder(tmp_path):
        pass  # refused before anything was committed
    (tmp_path / "stations.parquet").write_text("the user's", encoding="utf-8")
    with pytest.raises(StorageError, match="STORAGE-NOT-OURS"), open_folder(tmp_path):
        pass
    assert (tmp_path / "stations.parquet").read_text(encoding="utf-8") == "the user's"


def test_a_flipped_byte_in_a_small_file_is_seen_by_a_rerun(tmp_path: Path) -> None:
    commit(tmp_path, "stations.parquet", "observations/part-00000.parquet")
    manifest = read_manifest(tmp_path)
    assert manifest is not None
    assert find_damage(tmp_path, manifest, read=False) == []
    (tmp_path / "stations.parquet").write_text("stations.parqueT", encoding="utf-8")
    (damage,) = find_damage(tmp_path, manifest, read=False)
    assert "stations.parquet" in damage


@pytest.mark.parametrize("outputs", [5, [5], "x"])
def test_a_manifest_of_somebody_else_is_refused(tmp_path: Path, outputs: object) -> None:
    text = {"fingerprint": "", "mission": "", "exit_code": 0, "outputs": outputs}
    (tmp_path / "manifest.json").write_text(json.dumps(text), encoding="utf-8")
    with pytest.raises(StorageError, match="MANIFEST-UNREADABLE"):
        read_manifest(tmp_path)
