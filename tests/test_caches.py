"""What is kept to save time."""

from __future__ import annotations

from pathlib import Path

import jinja2

from unbend import caches
from unbend.report import html


def files(folder):
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def test_templates_are_parsed_again_by_another_program(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def parsed():
        html.environment.cache_clear()
        html.environment().get_template("report.html.j2")
        return files(tmp_path / "cache" / "unbend" / "templates")

    try:
        (first,) = parsed()
        assert parsed() == [first]
        monkeypatch.setattr(jinja2, "__version__", "4.0.0")
        assert len(parsed()) == 2
        (tmp_path / "report.py").write_text("a filter of its own")
        monkeypatch.setattr(html, "files", lambda _: tmp_path)
        assert len(parsed()) == 3
    finally:
        html.environment.cache_clear()


def test_the_compiler_uses_the_same_folder(monkeypatch, tmp_path):
    from unbend.refraction.kernels import jit

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    folder = jit.cache_folder.__wrapped__()
    assert folder is not None
    assert folder.startswith(caches.compiled_code())


def test_what_warm_compiles_is_what_missions_and_terrains_call(unbend, monkeypatch, tmp_path):
    """Nothing is compiled for other types of arguments: those of real tables, logs and rasters."""
    from tests.refraction.test_terrain import landing, rays_from, relief
    from tests.tables.geodata.test_elevation import write
    from unbend.batch.runs import check_mission
    from unbend.refraction.kernels.jit import Kernel, cache_folder
    from unbend.tables.geodata.elevation import open_elevation

    ended = unbend("warm")
    assert (ended.code, ended.out.strip()) == (0, cache_folder())
    kernels = {k.function.__name__: k for k in gc.get_objects() if type(k) is Kernel}
    assert len(kernels) == 14
    known = {name: list(kernel.by_types) for name, kernel in kernels.items()}
    assert all(known.values()), known
    code = "compile_kernels()\nimport sys\nassert 'numba' not in sys.modules"
    words = [sys.executable, "-c", f"from unbend.library import compile_kernels\n{code}"]
    # The folder that this process found first, maybe in another test that has its own.
    environment = os.environ | {"NUMBA_CACHE_DIR": os.path.dirname(ended.out.strip())}
    subprocess.run(words, check=True, env=environment)

    monkeypatch.setattr(Kernel, "always_compiled", True)
    check_mission(Path(__file__).parents[1] / "configs/sample_bin.yaml")
    write(tmp_path / "dem.tif", relief(200, 200), 8.0, -17.0)
    path = tmp_path / "dem.tif"
    model, _ = open_elevation([path], None, reference="msl", undulation=np.zeros_like)
    landing(model, *rays_from(30, -17.02, 8.02, 0.005, (3_000.0, 4_000.0), 3))
    assert {name: list(kernel.by_types) for name, kernel in kernels.items()} == known
