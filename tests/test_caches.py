"""What is kept to save time."""

from pathlib import Path

import jinja2

from unbend import caches
from unbend.report import report_page


def files(folder):
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def test_templates_are_parsed_again_by_another_program(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def parsed():
        report_page.environment.cache_clear()
        report_page.environment().get_template("report.html.j2")
        return files(tmp_path / "cache" / "unbend" / "templates")

    try:
        (first,) = parsed()
        assert parsed() == [first]
        monkeypatch.setattr(jinja2, "__version__", "4.0.0")
        assert len(parsed()) == 2
        (tmp_path / "report.py").write_text("a filter of its own")
        monkeypatch.setattr(report_page, "files", lambda _: tmp_path)
        assert len(parsed()) == 3
    finally:
        report_page.environment.cache_clear()


def test_the_compiler_uses_the_same_folder(monkeypatch, tmp_path):
    from unbend.refraction.kernels import jit

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    folder = jit.cache_folder.__wrapped__()
    assert folder is not None
    assert folder.startswith(caches.compiled_code_folder())


def test_what_warm_compiles_is_what_missions_call(unbend):
    """Nothing is compiled for other types of arguments: those of real tables and logs."""
    from unbend.batch.runs import check_mission
    from unbend.refraction.kernels import moments, outgoing, ray, shifts, sigma
    from unbend.refraction.kernels.jit import cache_folder

    ended = unbend("warm")
    assert (ended.code, ended.out.strip()) == (0, cache_folder())
    kernels = [
        outgoing.fill_outgoing_rays,
        shifts.fill_shifts,
        moments.bend_steep_rays,
        ray.bend_rays,
        sigma.fill_sigma_columns,
    ]
    known = [kernel.signatures for kernel in kernels]
    assert all(known)
    check_mission(Path(__file__).parents[1] / "configs/sample_bin.yaml")
    assert [kernel.signatures for kernel in kernels] == known
