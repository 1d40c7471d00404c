"""Arithmetic of commands that depends neither on AVX-512 nor on the number of threads.

numpy and OpenBLAS have code of their own for each kind of processor. With AVX-512 logarithms, sines
and sums differ from those with AVX2 in the last bits. Sums of OpenBLAS also depend on the number of
its threads.
"""

import os
from contextlib import suppress

PROCESSORS = "/proc/cpuinfo"


def use_same_arithmetic() -> None:
    """Let this process, and those that it starts, give the same bytes on all processors with AVX2.

    Takes effect if numpy is not imported yet. Processors with AVX-512 compute with AVX2, on Linux
    and with numpy 2.4 or newer; what the user has set for them stays. One thread of OpenBLAS is
    also faster: matrices have some hundred rows.
    """
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    if has_avx512():
        os.environ.setdefault("NPY_DISABLE_CPU_FEATURES", "X86_V4")  # numpy's name since 2.4
        os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")


def has_avx512() -> bool:
    """Whether the system lists AVX-512 among what its processors can do."""
    with suppress(OSError), open(PROCESSORS, encoding="ascii", errors="replace") as lines:
        for line in lines:
            if line.startswith("flags"):
                return "avx512f" in line.split()
    return False
