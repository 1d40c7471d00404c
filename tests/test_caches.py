"""What is kept to save time goes, and nothing else does."""

from __future__ import annotations

import json
from pathlib import Path

import jinja2
import pytest

from unbend import caches
from unbend.report import html


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """The user's cache and one of numba's, which other programs use too."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    ours = tmp_path / "numba" / "unbend-0123456789abcdef"
    (ours / "deep").mkdir(parents=True)
    (ours / "deep" / "ray.nbc").write_bytes(b"x" * 1000)
    (tmp_path / "numba" / "other_program").mkdir()
    (tmp_path / "numba" / "unbend-notes").write_text("mine")
    (tmp_path / "cache" / "unbend").mkdir(parents=True)
    (tmp_path / "cache" / "unbend" / "hashes.sqlite").write_bytes(b"y" * 500)
    (tmp_path / "cache" / "unbend" / "hashes.txt").write_text("mine")
    return tmp_path


def files(folder):
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def test_clean_removes_ours_and_nothing_else(folders, unbend):
    ended = unbend("clean", "--json")
    assert ended.code == 0
    removed = json.loads(ended.out)["removed"]
    assert [(r["what"], r["bytes"]) for r in removed] == [
        ("compiled code", 1000),
        ("hashes of inputs", 500),
    ]
    assert files(folders) == ["cache/unbend/hashes.txt", "numba/unbend-notes"]
    assert (folders / "numba" / "other_program").is_dir()
    assert unbend("clean").out == "nothing is kept\n"


def test_templates_are_parsed_again_by_another_program(folders, unbend, monkeypatch):
    def parsed():
        html.environment.cache_clear()
        html.environment().get_template("report.html.j2")
        return files(folders / "cache" / "unbend" / "templates")

    try:
        (first,) = parsed()
        assert parsed() == [first]
        monkeypatch.setattr(jinja2, "__version__", "4.0.0")
        assert len(parsed()) == 2
        (folders / "report.py").write_text("a filter of its own")
        monkeypatch.setattr(html, "files", lambda _: folders)
        assert len(parsed()) == 3
    finally:
        html.environment.cache_clear()
    removed = json.loads(unbend("clean", "--json").out)["removed"]
    assert [r["what"] for r in removed].count("templates") == 3


def test_clean_prints_where_it_was(folders, unbend):
    out = unbend("clean").out
    assert "removed compiled code, 0.0 MB:" in out
    assert str(folders / "numba" / "unbend-0123456789abcdef") in out


def test_what_cannot_be_removed_is_a_storage_failure(folders, unbend, monkeypatch):
    def refuses(path):
        raise PermissionError(13, "Permission denied", path)

    monkeypatch.setattr(caches.os, "remove", refuses)
    ended = unbend("clean")
    assert ended.code == 5
    assert "STORAGE-WRITE: Permission denied" in ended.err
    assert "hashes.sqlite" in ended.err


def test_the_compiler_uses_the_same_folder(monkeypatch, tmp_path):
    from unbend.refraction.kernels import jit

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    folder = jit.cache_folder.__wrapped__()
    assert folder is not None
    assert ("compiled code", folder) in caches.cached()


def test_what_warm_compiles_is_what_missions_call(unbend):
    """Nothing is compiled for other types of arguments: those of real tables and logs."""
    from unbend.batch.runs import check_mission
    from unbend.refraction.kernels import image, moments, ray, sigma
    from unbend.refraction.kernels.jit import cache_folder

    ended = unbend("warm")
    assert (ended.code, ended.out.strip()) == (0, cache_folder())
    kernels = [
        image.fill_outgoing_rays,
        image.shift_back,
        moments.bend_steep_rays,
        ray.bend_rays,
        sigma.propagate,
    ]
    known = [kernel.signatures for kernel in kernels]
    assert all(known)
    check_mission(Path(__file__).parents[1] / "configs/sample_bin.yaml")
    assert [kernel.signatures for kernel in kernels] == known
