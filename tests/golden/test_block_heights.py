"""What the corrections are worth in a bundle adjustment, over blocks that nobody has seen.

UNBEND_ADJUSTMENTS blocks (1; `make faults`: 30) are drawn from UNBEND_SEED for each
flying height, in the air of nine soundings. The truth of rays is the simulator's; see
`adjusted_block`.
"""

import os
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import pytest

pytest.importorskip("pycolmap")

from tests.draws import SEED
from tests.golden.adjusted_block import (
    SIGMA_PX,
    Block,
    adjust,
    correct,
    fly_block,
    heads,
    real_airs,
)
from unbend.atmosphere import Profile

COUNT = int(os.environ.get("UNBEND_ADJUSTMENTS", "1"))
# Over nine airs 0.14 to 0.21 m at 3 km; other blocks in other airs have up to half as much more.
UNCORRECTED_M = {
    3000.0: (0.12, 0.35),
    6000.0: (0.45, 0.8),
    9000.0: (0.9, 1.8),
}


@dataclass(frozen=True)
class Flown:
    """A block, the profile of its true air and the one that a flight's sensors give."""

    block: Block
    true: Profile
    adjusted: Profile

    @cached_property
    def uncorrected_m(self):
        return adjust(self.block, self.block.measured).z


@cache
def flown(height, draw):
    rng = np.random.default_rng([SEED, draw, int(height)])
    airs = real_airs()
    air = airs[rng.integers(len(airs))]
    seed = int(rng.integers(2**31))
    block = fly_block(air, height, seed, heads())
    return Flown(block, air.profile(), air.adjusted_profile(height, rng))


@pytest.fixture(scope="module", params=UNCORRECTED_M, ids=lambda h: f"{h / 1000:.0f}km")
def height(request):
    return request.param


@pytest.fixture
def first(height):
    return flown(height, 0)


def test_true_heights_come_back(height):
    low_m, high_m = UNCORRECTED_M[height]
    left = []
    for draw in range(COUNT):
        drawn = flown(height, draw)
        block = drawn.block
        assert set(block.stations.camera) == set(range(5))
        assert low_m < drawn.uncorrected_m < high_m
        assert adjust(block, correct(block, drawn.true)).z < 0.001
        corrected_m = adjust(block, correct(block, drawn.adjusted)).z
        left.append(corrected_m / drawn.uncorrected_m)
        if COUNT > 1:
            flown.cache_clear()
    assert max(left) <= 0.02
    assert np.count_nonzero(np.array(left) > 0.01) <= COUNT // 10


def test_noise_hides_what_is_left(height, first):
    """0.3 px: corrected observations are as good as ones that were never bent."""
    block = first.block
    noise = np.random.default_rng(SEED).normal(0.0, SIGMA_PX, block.measured.shape)

    perfect_m = adjust(block, block.straight + noise).z

    assert perfect_m > 0.02 * height / 3000.0
    for profile in (first.true, first.adjusted):
        corrected = correct(block, profile, block.measured + noise)
        assert adjust(block, corrected).z == pytest.approx(perfect_m, rel=0.005)
