"""Tables that are written, cell by cell, and round trips through them."""

import math
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.tables.observed import COLUMNS
from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate.adjusted_profile import unadjusted
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile
from unbend.flight.stations import empty_stations
from unbend.geodesy import lambert_gravity
from unbend.messages import Ledger
from unbend.tables.observations import open_observations
from unbend.tables.writing import (
    table_of,
    table_of_profile,
    table_of_profiles,
    table_of_stations,
    write_parquet,
)
from unbend.tables.written_columns import (
    OBSERVATION_COLUMNS,
    PROFILE_COLUMNS,
    STATION_COLUMNS,
    schema_of,
)

US = standard_atmosphere("us1976")
ICAN = standard_atmosphere("ican", index="gyer")


def test_a_column_that_nobody_fills_is_an_error():
    """None fills a column with nulls; a column that is forgotten is no such column."""
    number = pa.float64()
    schema = pa.schema({"a": number, "b": number})
    columns = {"a": np.array([1.0, np.nan])}
    with pytest.raises(KeyError, match="b"):
        table_of(columns, schema)

    columns["b"] = None

    expected = {"a": [1.0, None], "b": [None, None]}
    assert table_of(columns, schema).to_pydict() == expected


def test_the_profile_stands_beside_the_standard():
    """US 1976 as the profile of a flight whose standard is another: each value in its column."""
    h_m = 5000.0
    adjustment = replace(unadjusted(US, "a test"), standard=ICAN)

    table = table_of_profile(adjustment, "flight", [0.0, h_m])

    row = table.to_pylist()[-1]
    # US 1976, Table I: 255.676 K, 540.48 hPa at 5 km.
    assert row["temperature_k"] == pytest.approx(255.676, abs=1e-3)
    assert row["pressure_pa"] == pytest.approx(54_048.0, abs=2.0)
    expected = {
        "standard_temperature_k": ICAN.temperature(h_m),
        "standard_pressure_pa": ICAN.pressure(h_m),
        "standard_refractivity": ICAN.refractivity(h_m),
        "refractivity": US.refractivity(h_m),
    }
    for name, value in expected.items():
        assert row[name] == pytest.approx(value, rel=1e-12)
    assert row["profile_id"] == "flight"
    assert row["h_m"] == h_m
    assert row["sigma_temperature_k"] is None
    metadata = table.schema.metadata
    assert float(metadata[b"g_phi"]) == US.gravity.g_phi
    assert float(metadata[b"r_phi"]) == US.gravity.r_phi
    assert metadata[b"latitude"] == b""
    assert metadata[b"unbend.standard"] == ICAN.name.encode()
    assert float(metadata[b"unbend.wavelength_m"]) == US.index.wavelength_m
    assert table.num_rows == 2


def test_the_latitude_is_in_degrees():
    gravity = lambert_gravity(math.radians(47.0))
    adjustment = unadjusted(replace(US, gravity=gravity), "a test")

    metadata = table_of_profile(adjustment, "flight").schema.metadata

    assert float(metadata[b"latitude"]) == pytest.approx(47.0)


def test_stations_name_the_profile_of_their_own_air():
    names = np.array(["a", "b", "c"], object)
    cameras = np.full(3, "cam", object)
    stations = replace(
        empty_stations(names, cameras, "ok"),
        status=np.array(["ok", "in_gap", "ok"], object),
    )
    profiles = TimedProfile(5, US), TimedProfile(7, ICAN)
    series = ProfileSeries(profiles, np.array([1, 0, 0]))

    images = table_of_stations(stations, series).to_pydict()
    table = table_of_profiles(unadjusted(US, "a test"), series, [0.0])
    rows = table.to_pydict()

    assert images["profile_id"] == ["flight-002", None, "flight-001"]
    assert rows["profile_id"] == ["flight-001", "flight-002"]
    assert rows["temperature_k"] == pytest.approx([288.15, 288.0], abs=1e-9)
    assert [time.value for time in rows["time_utc"]] == [5, 7]


def test_units_and_conventions_are_in_the_schema():
    users = pa.field("users", pa.int8())
    schema = schema_of(OBSERVATION_COLUMNS, {"own": "value"}, [users])

    assert schema.names[-1] == "users"
    for field in schema:
        if field.metadata:
            unit = field.metadata[b"unit"].decode()
            assert "_" not in field.name or field.name.endswith(unit or ("id", "status"))
    assert b"Hamilton" in schema.metadata[b"unbend.conventions"]
    assert schema.metadata[b"own"] == b"value"


@pytest.mark.parametrize("columns", [STATION_COLUMNS, PROFILE_COLUMNS])
def test_one_precision_whatever_the_quantity(columns):
    kinds = set(schema_of(columns, {}).types)
    assert set(filter(pa.types.is_floating, kinds)) == {pa.float64()}


def test_sigmas_of_the_profile_each_in_its_column():
    """2 K at every edge of the layers and nothing else: 2 K at any height."""
    edges = US.layers.edge.size
    matrix = np.zeros((2 * edges + 1, 2 * edges + 1))
    matrix[:edges, :edges] = 4.0
    covariance = ProfileCovariance(US, 0.0, matrix)

    table = table_of_profile(
        unadjusted(US, "a test"),
        "flight",
        [1000.0, 4000.0],
        TimedProfile(None, US, covariance),
    )

    assert table["sigma_temperature_k"].to_pylist() == pytest.approx([2.0, 2.0])
    # dN / N = -dT / T at one pressure: 2 of 281.65 K at 1 km, less what the column below adds,
    # g / (R T) 1 km = 0.12 of it; at 4 km 2 of 262.2 K, less 0.49 of it.
    expected = [2.0 / 281.65 * 0.88, 2.0 / 262.2 * 0.51]
    sigma = np.array(table["sigma_refractivity"])
    refractivity = np.array(table["refractivity"])
    assert sigma / refractivity == pytest.approx(expected, rel=0.05)


def write_row_groups(folder):
    """Row groups of 4, some of them empty."""
    numbers = range(31)
    columns = {
        "image": [f"image_{number % 3}" for number in numbers],
        "point": [f"p{number}" for number in numbers],
        "x_px": np.arange(31.0),
        "y_px": np.arange(31.0) / 7,
        "own": numbers,
    }
    table = pa.table(columns)
    with pq.ParquetWriter(folder / "o.parquet", table.schema) as writer:
        parts = (
            table[:12],
            table[12:30],
            table[30:],
        )
        for part in parts:
            writer.write_table(part, 4)
            writer.write_table(table[:0])


def write_block(folder):
    """COLMAP's: three images with nine points."""
    model = folder / "block"
    model.mkdir()
    (model / "cameras.txt").write_text("1 SIMPLE_PINHOLE 99 99 50 49 49\n")
    observations = " ".join(f"{i}.5 {i}.25 {i}" for i in range(9))
    images = [f"{k} 1 0 0 0 0 0 {k} 1 {k}.jpg\n{observations}\n" for k in (1, 2, 3)]
    (model / "images.txt").write_text("".join(images))
    points = [f"{i} 0 0 {i} 0 0 0 1 1 {i} 2 {i} 3 {i}\n" for i in range(9)]
    (model / "points3D.txt").write_text("".join(points))


@pytest.mark.parametrize(
    ("write", "name", "file_format"),
    [
        (write_row_groups, "o.parquet", None),
        (write_block, "block", "colmap"),
    ],
)
def test_a_range_of_parts_is_what_the_whole_has_there(tmp_path, write, name, file_format):
    write(tmp_path)
    observations = open_observations(
        tmp_path / name,
        COLUMNS,
        None,
        Ledger(),
        file_format=file_format,
    )

    whole = list(observations.batches(4))

    for first in range(len(whole) + 1):
        for stop in (*range(first, len(whole) + 1), None):
            part = observations.batches(4, first, stop)
            for batch, expected in zip(part, whole[first:stop], strict=True):
                assert batch.first_row == expected.first_row
                assert batch.image.equals(expected.image)
                assert batch.point.equals(expected.point)
                assert batch.x_px.tolist() == expected.x_px.tolist()
                assert batch.users == expected.users


def test_floats_are_split_by_bytes_and_all_else_has_a_dictionary(tmp_path):
    path = tmp_path / "table.parquet"
    wide = np.linspace(0.0, 1.0, 1000)
    columns = {
        "wide": wide,
        "narrow": wide.astype(np.float32),
        "name": [f"p{i % 9}" for i in range(1000)],
        "count": np.arange(1000) % 7,
        "pair": [{"a": 1.5, "b": "x"}] * 1000,
    }
    table = pa.table(columns)

    write_parquet(table, path)

    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        assert file.read().equals(table)
        group = file.metadata.row_group(0)
    split = set()
    coded = set()
    for number in range(group.num_columns):
        column = group.column(number)
        if "BYTE_STREAM_SPLIT" in column.encodings:
            split.add(column.path_in_schema)
        if column.has_dictionary_page:
            coded.add(column.path_in_schema)
    assert split == {"wide", "narrow"}
    assert coded >= {"name", "count"}
    assert not coded & split


def test_what_was_read_of_a_large_table_does_not_stay_in_memory(tmp_path):
    path = tmp_path / "large.parquet"
    rows = 400_000
    rng = np.random.default_rng(0)
    names = ["a"] * rows
    columns = {
        "image": names,
        "point": names,
        "x_px": rng.uniform(0.0, 1000.0, rows),
        "y_px": rng.uniform(0.0, 1000.0, rows),
    }
    pq.write_table(pa.table(columns), path, row_group_size=10_000)
    observations = open_observations(path, COLUMNS, None, Ledger())

    before = pa.total_allocated_bytes()
    for _ in observations.batches(10_000):
        allocated = pa.total_allocated_bytes() - before
        assert allocated < path.stat().st_size / 2
