"""Machine code in the cache is that of the sources, whichever module was edited."""

from __future__ import annotations

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

import unbend
from unbend.refraction.kernels import jit, machine_code
from unbend.refraction.kernels.jit import source_hash
from unbend.refraction.kernels.threads import BLOCK_ROWS

ROOM = Path(unbend.__file__).parent / "refraction"
DISTORTED = """
import numpy as np
from unbend.refraction import BrownConrady, Camera
from unbend.refraction.kernels.jit import Kernel
Kernel.always_compiled = True
camera = Camera(1000, 1000, 1000.0, 1000.0, 0.0, 0.0, BrownConrady(k1=0.5))
print(camera.rays(np.array([100.0]), np.array([0.0]))[0][0])
"""


def run(code: str, tree: Path, cache: Path | str, **environment: str) -> str:
    """What a new process prints that imports the package from a tree."""
    surroundings = os.environ | {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-W", "error", "-c", code]
    return subprocess.run(
        command, check=True, env=surroundings | environment, capture_output=True, text=True,
        cwd=tree,
    ).stdout.strip()  # fmt: skip


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of the package."""
    shutil.copytree(
        ROOM.parent, tmp_path / "tree" / "unbend", ignore=shutil.ignore_patterns("__pycache__")
    )
    return tmp_path / "tree"


def test_an_edited_helper_is_compiled_again_and_old_code_removed(tree, tmp_path):
    """The model is no entry function: the folder is that of the hash of all."""
    cache = tmp_path / "cache"
    u = float(run(DISTORTED, tree, cache))
    assert u + 0.5 * u**3 == pytest.approx(0.1, abs=1e-14)
    (old,) = cache.iterdir()
    foreign = [cache / "unbend-notes", cache / "unbend-0123456789abcdeg", cache / "other"]
    for folder in foreign:
        folder.mkdir()
    recent = cache / "unbend-0123456789abcdef"
    recent.mkdir()
    linked = "import sys\nassert 'numba' not in sys.modules\n"
    assert float(run(DISTORTED + linked, tree, cache)) == u
    assert old in cache.iterdir()

    model = tree / "pipeline/unbend/refraction/camera/brown_conrady.py"
    text = model.read_text()
    assert text.count("radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))") == 2
    model.write_text(text.replace("r2 * (k1 + r2 * (k2", "r2 * (2.0 * k1 + r2 * (k2"))
    for folder in (old, *foreign):
        os.utime(folder, (time.time() - 8 * 86_400,) * 2)
    edited = float(run(DISTORTED, tree, cache))
    assert edited + edited**3 == pytest.approx(0.1, abs=1e-13)
    assert not old.exists()
    assert recent.exists()
    assert all(folder.exists() for folder in foreign)
    (new,) = set(cache.iterdir()) - {recent, *foreign}
    assert re.fullmatch(r"unbend-[0-9a-f]{16}", new.name)
    assert any(new.rglob("*.o"))


def test_code_that_is_damaged_is_not_linked(tmp_path):
    path = tmp_path / "kernel.o"
    machine_code.keep(str(path), "symbol", [], bytes(1000))
    whole = path.read_bytes()
    for damaged in (b"", whole[:-1], whole[:40], whole[:50] + b"x" + whole[51:]):
        path.write_bytes(damaged)
        assert machine_code.linked(str(path)) is None
    assert machine_code.linked(str(tmp_path / "none")) is None


FIRST_OF_PROCESS = """
import ctypes, sys
import llvmlite.binding as llvm
from unbend.refraction.kernels import machine_code
target, _ = machine_code._machine()
text = '''declare double @asin(double)
define double @angle(double %x) {
  %y = call double @asin(double %x)
  ret double %y
}'''
code = target.create_target_machine(codemodel="jitdefault").emit_object(llvm.parse_assembly(text))
machine_code.keep(sys.argv[1], "angle", ["asin"], code)
address = machine_code.linked(sys.argv[1])
print(ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(address)(0.5) if address else address)
"""


def test_the_first_code_of_a_process_may_call_the_c_library(tmp_path):
    """LLVM knows no function of the C library before its first engine: all was compiled again."""
    told = subprocess.run(
        [sys.executable, "-c", FIRST_OF_PROCESS, str(tmp_path / "angle.o")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert float(told.stdout) == pytest.approx(np.pi / 6.0, abs=1e-15)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="permissions are those of POSIX")
def test_nothing_is_written_where_nothing_can_be(tree, tmp_path):
    """A file in the place of the folder, which root cannot write to either."""
    blocked = tmp_path / "blocked"
    blocked.write_text("")
    assert (
        run(
            "from unbend.refraction.kernels.jit import cache_folder; print(cache_folder())",
            tree,
            blocked / "cache",
        )
        == "None"
    )
    assert blocked.read_text() == ""
    assert not list(tree.rglob("*.o"))


def test_every_source_that_may_be_compiled_in_is_hashed(tmp_path):
    """What the kernels import from the package, but for types, lies in the folders hashed."""
    seen, left = set(), [*ROOM.glob("kernels/*.py"), *ROOM.glob("camera/*.py")]
    # Nothing in these is compiled: they hand arrays to what is.
    left = [path for path in left if path.name not in ("jit.py", "threads.py")]
    for path in left:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("unbend"):
                seen |= {f"{node.module}.{name.name}" for name in node.names}
    hashed = re.compile(r"unbend\.refraction\.(status_codes|(kernels|camera)\.\w+)(\.\w+)*")
    assert len(seen) > 5
    others = {name for name in seen if not hashed.fullmatch(name)}
    assert others == {f"unbend.units.{name}" for name in ("Array", "Integers", "Mask", "Rows")}

    copy = tmp_path / "refraction"
    shutil.copytree(ROOM, copy)
    assert source_hash(str(copy)) == source_hash()
    for path in ("status_codes.py", "camera/brown_conrady.py", "kernels/grazing.py"):
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
    assert run(code, tree, tree / "cache") == "True"


def test_arguments_that_numba_takes_otherwise_are_refused():
    """How numba hands over arrays is its own affair: what differs is seen in the code it made."""
    dispatcher = numba.njit(no_cpython_wrapper=True)(lambda columns, whole: None)
    arguments = ((np.zeros((2, 3)), 1.5), True)
    machine_code.flatten(arguments, [], words := [])
    assert machine_code.compiled(dispatcher, arguments, words)[0]
    for wrong in (words[1:], [*words[:-1], 1.0], [float(words[0]), *words[1:]], [*words, 0]):
        with pytest.raises(RuntimeError, match="takes other arguments"):
            machine_code.compiled(dispatcher, arguments, wrong)


def halved(x):
    for i in range(x.size):
        x[i] = 0.5 * x[i]


@pytest.mark.parametrize("kept", [True, False])
def test_what_is_interpreted_counts_until_it_is_worth_compiling(kept, monkeypatch, tmp_path):
    """Over all processes, each with a kernel of its own here; a large call does not wait."""
    folder = tmp_path if kept else None
    monkeypatch.setattr(jit, "cache_folder", lambda: folder and str(folder))
    compiled, original = [], machine_code.compiled
    monkeypatch.setattr(
        machine_code, "compiled", lambda *a: compiled.append(len(compiled)) or original(*a)
    )

    def process(*calls, most=10_000):
        kernel = jit.entry(rows=0, most=most)(halved)
        for rows in calls:
            kernel(x := np.ones(rows))
            assert (x == 0.5).all()
        return len(compiled)

    assert process(90, 4_000, 4_000) == 0
    assert process(90, 1_500) == 0
    if kept:
        assert process(90, 400, 400) == 1
        assert process(4_000, 4_000, 4_000) == 1, "linked"
    else:
        assert process(4_000, 4_000, 2_001) == 1
    for path in tmp_path.iterdir():
        path.unlink()
    assert process(BLOCK_ROWS - 1, most=100_000) == 1
    assert process(BLOCK_ROWS, most=100_000) == 2
