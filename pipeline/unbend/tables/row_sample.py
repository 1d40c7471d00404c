"""A few rows of a large table, spread over its images."""

from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from unbend.units import Array, Integers

_SHARE_BITS = 40  # of scattered numbers, below those of the image in a number to sort by


def _no_rows() -> Integers:
    return np.zeros(0, np.int64)


@dataclass
class RowSample:
    """At most ``most`` rows of a table, spread over its images, drawn in one pass over their names.

    An image has as many as any other, or all of its own where these are fewer. The same table
    gives the same rows. ``counts`` are the rows of each image, ``of_each`` the most drawn of one.

    >>> sample = RowSample(4)
    >>> sample.add(pa.array(["a"] * 7 + ["b", None]))
    >>> sample.number.tolist(), sample.weights.tolist()
    ([0, 5, 7, 8], [3.5, 3.5, 1.0, 1.0])
    """

    most: int
    of_each: int = 1 << 62
    counts: Integers = field(default_factory=_no_rows)
    number: Integers = field(default_factory=_no_rows)
    image: Integers = field(default_factory=_no_rows)
    _codes: dict[str | None, int] = field(default_factory=dict)

    def add(self, names: pa.StringArray | pa.DictionaryArray) -> None:
        """The images of the next rows of the table."""
        image = self._numbers_of(names)
        first_number = self.counts.sum()
        number = first_number + np.arange(image.size)
        self.counts = np.pad(
            self.counts,
            (0, len(self._codes) - self.counts.size),
        )
        rows = np.bincount(image, minlength=self.counts.size)
        self.counts += rows
        self.of_each = min(self.of_each, self._most_of_each())
        chosen = self._candidates(image, number, rows)
        image = np.append(self.image, image[chosen])
        number = np.append(self.number, number[chosen])
        kept = self._kept(image, number)
        self.number = number[kept]
        self.image = image[kept]

    def _numbers_of(self, names: pa.StringArray | pa.DictionaryArray) -> Integers:
        """(n,) the numbers of images, in the order in which they came first; null is an image."""
        encoded = names.dictionary_encode()
        images = encoded.dictionary.to_pylist()
        if encoded.null_count > 0:
            images.append(None)
        codes = []
        for image in images:
            code = self._codes.setdefault(image, len(self._codes))
            codes.append(code)
        place = encoded.indices.fill_null(len(images) - 1)
        rows = place.to_numpy(zero_copy_only=False)
        number_of_place = np.array(codes, np.int64)
        return np.asarray(number_of_place[rows])

    def _most_of_each(self) -> int:
        """How many rows of each image fit together."""
        counts = np.minimum(self.counts, self.most)
        images_with = np.bincount(counts, minlength=self.most + 1)
        # Images with more than 0, 1, 2 ... rows, and the rows if each has one more at most.
        from_most = images_with[:0:-1]
        images_with_more = from_most.cumsum()[::-1]
        rows_drawn = images_with_more.cumsum()
        return int(np.searchsorted(rows_drawn, self.most, "right"))

    def _candidates(
        self,
        image: Integers,
        number: Integers,
        rows: Integers,
    ) -> Integers:
        """The rows (k,) of a part of the table among which those drawn are.

        Of an image, which has ``rows`` in this part, three times those that can be drawn are
        sorted, where these have them all.
        """
        drawn = np.minimum(rows, max(self.of_each, 1))
        part = 3.0 * drawn / np.maximum(rows, 1)
        share = np.minimum(part, 1.0) * (1 << _SHARE_BITS)
        scattered = _scattered(number)
        largest_share = np.uint64(share.max(initial=0.0))
        low = np.flatnonzero(scattered <= largest_share)
        share_of_row = share.astype(np.uint64)[image[low]]
        low = low[scattered[low] <= share_of_row]
        low_of_image = np.bincount(image[low], minlength=rows.size)
        has_too_few = low_of_image < drawn
        if has_too_few.any():
            all_of_these = np.flatnonzero(has_too_few[image])
            low = np.union1d(low, all_of_these)
        return low

    def _kept(
        self,
        image: Integers,
        number: Integers,
    ) -> Integers:
        """The rows drawn of candidates, in their order: of each image those that are scattered."""
        image_bits = image.astype(np.uint64) << np.uint64(_SHARE_BITS)
        order = np.argsort(image_bits | _scattered(number))
        sorted_image = image[order]
        begin = np.searchsorted(sorted_image, np.arange(self.counts.size))
        rank = np.arange(order.size) - begin[sorted_image]
        kept = order[rank < max(self.of_each, 1)]
        if self.of_each == 0:  # more images than rows: of some of them one
            by_scatter = np.argsort(
                _scattered(image[kept]),
                kind="stable",
            )
            kept = kept[by_scatter[: self.most]]
        return np.sort(kept)

    @property
    def weights(self) -> Array:
        """(m,) rows of the table that each row drawn stands for."""
        drawn = np.bincount(
            self.image,
            minlength=self.counts.size,
        )
        weights = self.counts[self.image] / drawn[self.image]
        factor = self.counts.sum() / weights.sum()
        return np.asarray(weights * factor)


def _scattered(number: Integers) -> NDArray[np.uint64]:
    """Multiples of the golden ratio: of consecutive numbers the lowest lie evenly among them."""
    scattered = number.astype(np.uint64)
    scattered *= np.uint64(0x9E3779B97F4A7C15)
    scattered >>= np.uint64(64 - _SHARE_BITS)
    return scattered
