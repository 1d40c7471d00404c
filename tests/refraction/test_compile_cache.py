"""Compiled code in the cache is that of the sources, whichever module was edited."""

import ast
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest
from filelock import FileLock

import unbend
from tests.refraction.comparing import assert_near
from unbend.refraction.kernels import jit
from unbend.refraction.kernels.jit import compiled_sources, source_hash

ROOM = Path(unbend.__file__).parent / "refraction"
DISTORTED = """
import numpy as np
from unbend.refraction import BrownConrady, Camera
from unbend.refraction.kernels import jit
compiled = []
class Names(list):
    def append(self, name):
        compiled.append(name)
        super().append(name)
jit.COMPILING = Names()
camera = Camera(1000, 1000, 1000.0, 1000.0, 0.0, 0.0, BrownConrady(k1=0.5))
print(camera.rays(np.array([100.0]), np.array([0.0]))[0][0], "rays_of_pixels" in compiled)
"""


def run(code, tree, cache):
    """The words that a new process prints that imports the package from a tree."""
    environment = {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(cache)}
    ended = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        check=True,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        cwd=tree,
    )
    return ended.stdout.split()


@pytest.fixture
def tree(tmp_path):
    """A copy of the package."""
    copy = tmp_path / "tree"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOM.parent, copy / "unbend", ignore=ignored)
    return copy


def test_an_edited_helper_is_compiled_again_and_old_code_removed(tree, tmp_path):
    """The model is no entry function: numba alone would take what it kept, with a warm cache."""
    cache = tmp_path / "cache"
    first, compiled = run(DISTORTED, tree, cache)
    u = float(first)
    assert compiled == "True"
    assert_near(u + 0.5 * u**3, 0.1, 1e-14)
    (old,) = cache.iterdir()
    foreign = [cache / "unbend-notes", cache / "unbend-0123456789abcdeg", cache / "other"]
    for folder in foreign:
        folder.mkdir()
    recent = cache / "unbend-0123456789abcdef"
    recent.mkdir()
    assert run(DISTORTED, tree, cache) == [first, "False"], "kept"
    assert old in cache.iterdir()

    model = tree / "unbend/refraction/camera/brown_conrady.py"
    text = model.read_text()
    assert text.count("radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))") == 2
    model.write_text(text.replace("r2 * (k1 + r2 * (k2", "r2 * (2.0 * k1 + r2 * (k2"))
    for folder in (old, *foreign):
        os.utime(folder, (time.time() - 8 * 86_400,) * 2)
    edited, compiled = run(DISTORTED, tree, cache)
    assert compiled == "True"
    assert_near(float(edited) + float(edited) ** 3, 0.1, 1e-13)
    assert not old.exists()
    assert recent.exists()
    assert all(folder.exists() for folder in foreign)
    (new,) = set(cache.iterdir()) - {recent, *foreign}
    assert re.fullmatch(r"unbend-[0-9a-f]{16}", new.name)
    assert any(new.rglob("*.nbc"))
    assert not list(tree.rglob("*.nbc"))


def test_it_compiles_in_memory_where_nothing_can_be_written(tree, tmp_path):
    """A file in the place of the folder, which root cannot write to either."""
    blocked = tmp_path / "blocked"
    blocked.write_text("")
    code = DISTORTED + "print(jit.cache_folder())"
    u, compiled, folder = run(code, tree, blocked / "cache")
    assert_near(float(u) + 0.5 * float(u) ** 3, 0.1, 1e-14)
    assert (compiled, folder) == ("True", "None")
    assert blocked.read_text() == ""
    assert not list(tree.rglob("*.nb?"))


def test_every_source_that_may_be_compiled_in_is_hashed(tmp_path):
    """What the kernels import from the package, but for types, is in the folders hashed."""
    seen = set()
    for path in [*ROOM.glob("kernels/*.py"), *ROOM.glob("camera/*.py")]:
        # Nothing in these is compiled: they hand arrays to what is.
        if path.name in ("jit.py", "threads.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("unbend"):
                seen |= {f"{node.module}.{name.name}" for name in node.names}
    hashed = re.compile(r"unbend\.refraction\.(status_codes|(kernels|camera)\.\w+)(\.\w+)*")
    assert len(seen) > 5
    not_hashed = {name for name in seen if not hashed.fullmatch(name)}
    assert not_hashed - {"unbend.refraction.camera.model_of"} == {
        "unbend.units.Array",
        "unbend.units.Integers",
        "unbend.units.Mask",
        "unbend.units.Rows",
    }

    copy = tmp_path / "refraction"
    shutil.copytree(ROOM, copy)
    assert source_hash(str(copy)) == source_hash()
    for path in ("status_codes.py", "camera/brown_conrady.py", "kernels/grazing.py"):
        assert path in compiled_sources(str(copy))
        before = source_hash(str(copy))
        with (copy / path).open("a") as source:
            source.write("\n")
        assert source_hash(str(copy)) != before, path


def test_the_package_is_imported_where_there_is_no_fork(tree):
    """As on Windows: no fork, no affinity of processes."""
    code = (
        "import os\n"
        "for name in ('register_at_fork', 'fork', 'sched_getaffinity'):\n"
        "    if hasattr(os, name): delattr(os, name)\n"
        "import unbend.refraction\n"
        "from unbend.refraction.kernels.threads import usable_cpus\n"
        "print(usable_cpus() >= 1)\n"
    )
    assert run(code, tree, tree / "cache") == ["True"]


def test_kernels_hold_no_lock_while_they_run():
    """Threads work on blocks of rows beside each other."""
    from unbend.refraction.kernels import grazing, moments, outgoing, ray, shifts, sigma, terrain

    kernels = [
        grazing.bend_grazing_rays,
        outgoing.fill_outgoing_rays,
        shifts.fill_shifts,
        moments.bend_steep_rays,
        ray.bend_rays,
        ray.ray_heights,
        sigma.fill_sigma_columns,
        terrain.follow_rays,
    ]
    assert all(kernel.targetoptions["nogil"] for kernel in kernels)
    assert not any(kernel.targetoptions.get("fastmath") for kernel in kernels)
    assert jit.OPTIONS["nogil"]
    assert "fastmath" not in jit.OPTIONS
    for path in ROOM.glob("kernels/*.py"):
        assert path.name == "jit.py" or "numba.njit" not in path.read_text(), path


def divided(x, y):
    for i in range(x.size):
        x[i] = x[i] / y[i]


@pytest.mark.parametrize("kept", [True, False])
def test_a_division_by_zero_is_infinite_as_in_numpy(kept, monkeypatch, tmp_path):
    # A process asks for its folder once; NUMBA_CACHE_DIR would be set too late.
    monkeypatch.setattr(jit, "cache_folder", lambda: str(tmp_path) if kept else None)
    folder_of_user = numba.config.CACHE_DIR
    x = np.array([1.0, 0.0])
    jit.entry(divided)(x, np.zeros(2))
    assert np.isinf(x[0])
    assert np.isnan(x[1])
    assert bool(list(tmp_path.rglob("*.nbc"))) == kept
    # Functions of the user are cached where the user says; ours alone go to our folder.
    assert folder_of_user == numba.config.CACHE_DIR


def patient_lock(path, timeout):
    assert timeout == 0.0, "a kernel waits again for a process that is stopped"
    return FileLock(path, timeout=timeout)


def test_while_another_process_compiles_nothing_is_kept(monkeypatch, tmp_path):
    """numba numbers the files of a function: two writers may give each other's code to a type."""
    # A process asks for its folder once, and has minutes of patience with a lock.
    monkeypatch.setattr(jit, "cache_folder", lambda: str(tmp_path))
    monkeypatch.setattr(jit, "COMPILED_WITHIN_S", 0.1)
    kernel = jit.entry(divided)
    x = np.array([3.0, 1.0])
    with FileLock(tmp_path / "divided.lock"):
        kernel(x, np.array([2.0, 4.0]))
        assert x.tolist() == [1.5, 0.25]
        monkeypatch.setattr(jit, "FileLock", patient_lock)  # sees how long it would wait
        kernel(np.ones(2), np.ones(2))  # which waits no more
    assert not list(tmp_path.rglob("*.nbc"))
    kernel(x, np.array([2.0, 4.0]))
    assert x.tolist() == [0.75, 0.0625]
    assert len(list(tmp_path.rglob("*.nbc"))) == 1
