"""A few rows of a large table, spread over its images."""

from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from unbend.units import Array, Integers

_SCATTER_BITS = 40  # of scattered numbers; the 24 bits above them are for the image when sorting


def _no_rows() -> Integers:
    """An empty column of integers."""
    return np.zeros(0, np.int64)


@dataclass
class RowSample:
    """At most ``most`` rows of a table, spread over its images, drawn in one pass over their names.

    Of each image the same number of rows is drawn, or all if it has fewer. The same table gives the
    same rows. Images are numbered from 0 in the order in which they first occur; null counts as an
    image.

    ``number`` (m,) are the indices of the drawn rows in the table, in increasing order, and
    ``image`` (m,) the numbers of their images. ``counts`` (i,) are the rows of each image in the
    table so far, and ``most_of_image`` is the limit for each image; 0 if there are more images than
    rows to draw.

    >>> sample = RowSample(4)
    >>> sample.add(pa.array(["a"] * 7 + ["b", None]))
    >>> sample.number.tolist(), sample.weights.tolist()
    ([0, 5, 7, 8], [3.5, 3.5, 1.0, 1.0])
    """

    most: int
    most_of_image: int = 1 << 62
    counts: Integers = field(default_factory=_no_rows)
    number: Integers = field(default_factory=_no_rows)
    image: Integers = field(default_factory=_no_rows)
    _number_of_image: dict[str | None, int] = field(default_factory=dict)

    def add(self, names: pa.StringArray | pa.DictionaryArray) -> None:
        """Draw anew, with the next rows (n,) of the table; ``names`` are those of their images."""
        image = self._numbers_of_images(names)
        first_number = self.counts.sum()
        number = first_number + np.arange(image.size)
        self.counts = np.pad(
            self.counts,
            (0, len(self._number_of_image) - self.counts.size),
        )
        counts_of_part = np.bincount(image, minlength=self.counts.size)
        self.counts += counts_of_part
        self.most_of_image = min(self.most_of_image, self._limit_of_images())
        candidates = self._candidates(image, number, counts_of_part)
        image = np.append(self.image, image[candidates])
        number = np.append(self.number, number[candidates])
        drawn = self._drawn(image, number)
        self.number = number[drawn]
        self.image = image[drawn]

    def _numbers_of_images(self, names: pa.StringArray | pa.DictionaryArray) -> Integers:
        """(n,) the number of each row's image; new images get the next numbers."""
        encoded = names.dictionary_encode()
        images = encoded.dictionary.to_pylist()
        if encoded.null_count > 0:
            images.append(None)
        numbers = []
        for image in images:
            number = self._number_of_image.setdefault(image, len(self._number_of_image))
            numbers.append(number)
        index = encoded.indices.fill_null(len(images) - 1)  # null is the last image
        index_of_row = index.to_numpy(zero_copy_only=False)
        number_of_index = np.array(numbers, np.int64)
        return np.asarray(number_of_index[index_of_row])

    def _limit_of_images(self) -> int:
        """The largest k for which k rows of each image, or all if fewer, are at most ``most``."""
        counts = np.minimum(self.counts, self.most)
        images_with_count = np.bincount(counts, minlength=self.most + 1)
        # (most,) images with at least 1, 2, 3 ... rows; sums of these are the rows for k = 1, 2 ...
        from_largest_count = images_with_count[:0:-1]
        images_with_at_least = from_largest_count.cumsum()[::-1]
        rows_drawn = images_with_at_least.cumsum()
        return int(np.searchsorted(rows_drawn, self.most, "right"))

    def _candidates(
        self,
        image: Integers,
        number: Integers,
        counts: Integers,
    ) -> Integers:
        """Indices (k,) of the new rows that can be drawn: a few of each image, for less sorting.

        ``image``, ``number`` (n,) are those of the new rows, ``counts`` (i,) the new rows of each
        image. About three times as many rows as can be drawn are candidates: those with the lowest
        scattered numbers. If that leaves too few of an image, all its rows are candidates.
        """
        most_drawn = np.minimum(counts, max(self.most_of_image, 1))
        share = 3.0 * most_drawn / np.maximum(counts, 1)  # of the rows of each image
        limit = np.minimum(share, 1.0) * (1 << _SCATTER_BITS)
        scattered = _scattered(number)
        largest_limit = np.uint64(limit.max(initial=0.0))
        low = np.flatnonzero(scattered <= largest_limit)
        limit_of_row = limit.astype(np.uint64)[image[low]]
        low = low[scattered[low] <= limit_of_row]
        low_of_image = np.bincount(image[low], minlength=counts.size)
        has_too_few = low_of_image < most_drawn
        if has_too_few.any():
            all_of_these = np.flatnonzero(has_too_few[image])
            low = np.union1d(low, all_of_these)
        return low

    def _drawn(
        self,
        image: Integers,
        number: Integers,
    ) -> Integers:
        """Indices of the rows to draw among candidates (n,), in increasing order.

        Of each image these are the rows with the lowest scattered numbers.
        """
        image_bits = image.astype(np.uint64) << np.uint64(_SCATTER_BITS)
        order = np.argsort(image_bits | _scattered(number))  # by image, then by scattered number
        sorted_image = image[order]
        begin = np.searchsorted(sorted_image, np.arange(self.counts.size))
        rank = np.arange(order.size) - begin[sorted_image]  # of a row within its image
        drawn = order[rank < max(self.most_of_image, 1)]
        if self.most_of_image == 0:  # more images than rows: one row of some images
            by_scatter = np.argsort(
                _scattered(image[drawn]),
                kind="stable",
            )
            drawn = drawn[by_scatter[: self.most]]
        return np.sort(drawn)

    @property
    def weights(self) -> Array:
        """(m,) how many rows of the table each drawn row represents; their sum is all rows."""
        drawn_of_image = np.bincount(
            self.image,
            minlength=self.counts.size,
        )
        rows_of_image = self.counts[self.image]
        weights = rows_of_image / drawn_of_image[self.image]
        factor = self.counts.sum() / weights.sum()  # images without a drawn row count too
        return np.asarray(weights * factor)


def _scattered(number: Integers) -> NDArray[np.uint64]:
    """(n,) 40-bit fractions of multiples of the golden ratio, which order rows as if at random.

    Of consecutive numbers, those with the lowest results are evenly spaced.
    """
    scattered = number.astype(np.uint64)
    scattered *= np.uint64(0x9E3779B97F4A7C15)
    scattered >>= np.uint64(64 - _SCATTER_BITS)
    return scattered
