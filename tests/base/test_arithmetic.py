"""Processors with AVX-512 compute as those with AVX2 alone: environments for numpy and OpenBLAS."""

import os

import pytest

from unbend import arithmetic

WITHOUT = "flags\t\t: fpu sse2 avx2 fma\n"
WITH = "processor\t: 0\nflags\t\t: fpu avx2 avx512f avx512dq\n"
SET_BY_IT = ("OPENBLAS_NUM_THREADS", "NPY_DISABLE_CPU_FEATURES", "OPENBLAS_CORETYPE")


@pytest.fixture
def processors(tmp_path, monkeypatch):
    """Makes the system list processors; the environment is that of a new process."""
    for name in SET_BY_IT:
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)

    def write(text):
        file = tmp_path / "cpuinfo"
        file.write_text(text, "ascii")
        monkeypatch.setattr(arithmetic, "PROCESSORS", str(file))

    return write


def settings():
    return [os.environ.get(name) for name in SET_BY_IT]


def test_with_avx512_it_is_left_out(processors):
    processors(WITH)
    arithmetic.use_same_arithmetic()
    assert settings() == ["1", "X86_V4", "Haswell"]


@pytest.mark.parametrize("text", [WITHOUT, "", "Features : asimd\n"])
def test_other_processors_compute_as_they_are(processors, text):
    processors(text)
    arithmetic.use_same_arithmetic()
    assert settings() == ["1", None, None]


def test_without_a_list_of_processors_nothing_is_known(processors, monkeypatch, tmp_path):
    monkeypatch.setattr(arithmetic, "PROCESSORS", str(tmp_path / "missing"))
    assert not arithmetic.has_avx512()


def test_what_a_user_sets_stays(processors, monkeypatch):
    processors(WITH)
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Zen")
    arithmetic.use_same_arithmetic()
    assert settings() == ["1", "X86_V4", "Zen"]
