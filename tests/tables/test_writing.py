"""Tables that are written, cell by cell, and round trips through them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from unbend.atmosphere import standard_atmosphere
from unbend.atmosphere.covariance import ProfileCovariance
from unbend.atmosphere.estimate.adjusted_profile import unadjusted
from unbend.atmosphere.series.profile_series import ProfileSeries, TimedProfile
from unbend.errors import InputError
from unbend.flight.stations import empty_stations
from unbend.geodesy import lambert_gravity
from unbend.messages import Ledger
from unbend.tables import delimited
from unbend.tables.exports.format import write_csv_stream
from unbend.tables.imports.user_tables import read_events
from unbend.tables.observations import open_observations
from unbend.tables.refraction_mark import refuse_done
from unbend.tables.schemas import OBSERVATION_COLUMNS, PROFILE_COLUMNS, STATION_COLUMNS, schema_of
from unbend.tables.text_columns import refuse_other_pixels
from unbend.tables.writing import (
    table_of_profile,
    table_of_profiles,
    table_of_stations,
    write_parquet,
)

US = standard_atmosphere("us1976")
ICAN = standard_atmosphere("ican", index="gyer")
COLUMNS = {"image": "image", "point": "point", "x_px": "x_px", "y_px": "y_px"}


def test_the_profile_stands_beside_the_standard():
    """US 1976 as the profile of a flight whose standard is another: each value in its column."""
    adjustment = replace(unadjusted(US, "a test"), standard=ICAN)
    table = table_of_profile(adjustment, "flight", [0.0, 5000.0])
    row = table.slice(1).to_pylist()[0]
    # US 1976, Table I: 255.676 K, 540.48 hPa at 5 km; ICAN: 15 - 32.5 degC, 540.2 hPa.
    assert row["temperature_k"] == pytest.approx(255.676, abs=1e-3)
    assert row["pressure_pa"] == pytest.approx(54_048.0, abs=2.0)
    assert row["standard_temperature_k"] == pytest.approx(ICAN.temperature(5000.0), rel=1e-12)
    assert row["standard_pressure_pa"] == pytest.approx(ICAN.pressure(5000.0), rel=1e-12)
    assert row["standard_refractivity"] == pytest.approx(ICAN.refractivity(5000.0), rel=1e-12)
    assert row["refractivity"] == pytest.approx(US.refractivity(5000.0), rel=1e-12)
    assert (row["profile_id"], row["h_m"], row["sigma_temperature_k"]) == ("flight", 5000.0, None)
    said = table.schema.metadata
    assert float(said[b"g_phi"]) == US.gravity.g_phi
    assert float(said[b"r_phi"]) == US.gravity.r_phi
    assert (said[b"latitude"], said[b"unbend.standard"]) == (b"", ICAN.name.encode())
    assert float(said[b"unbend.wavelength_m"]) == US.index.wavelength_m


def test_the_latitude_is_in_degrees():
    there = replace(US, gravity=lambert_gravity(math.radians(47.0)))
    said = table_of_profile(unadjusted(there, "a test"), "flight").schema.metadata
    assert float(said[b"latitude"]) == pytest.approx(47.0)


def test_stations_name_the_profile_of_their_own_air():
    stations = empty_stations(np.array(["a", "b", "c"], object), np.full(3, "cam", object), "ok")
    stations = replace(stations, status=np.array(["ok", "in_gap", "ok"], object))
    series = ProfileSeries((TimedProfile(5, US), TimedProfile(7, ICAN)), np.array([1, 0, 0]))
    assert table_of_stations(stations, series)["profile_id"].to_pylist() == [
        "flight-002",
        None,
        "flight-001",
    ]
    profiles = table_of_profiles(unadjusted(US, "a test"), series, [0.0])
    assert profiles["profile_id"].to_pylist() == ["flight-001", "flight-002"]
    assert profiles["temperature_k"].to_pylist() == pytest.approx([288.15, 288.0], abs=1e-9)
    assert [when.value for when in profiles["time_utc"].to_pylist()] == [5, 7]


def test_units_and_conventions_are_in_the_schema():
    schema = schema_of(OBSERVATION_COLUMNS, {"own": "value"}, [pa.field("users", pa.int8())])
    assert schema.names[-1] == "users"
    units = {item.name: item.metadata[b"unit"] for item in schema if item.metadata}
    for name, unit in units.items():
        if "_" in name:
            assert name.endswith(unit.decode() or ("id", "status"))
    assert b"Hamilton" in schema.metadata[b"unbend.conventions"]
    for columns in (STATION_COLUMNS, PROFILE_COLUMNS):  # one precision, whatever the quantity
        kinds = {kind for kind, _, _ in columns.values() if pa.types.is_floating(kind)}
        assert kinds == {pa.float64()}
    assert schema.metadata[b"own"] == b"value"


@pytest.mark.parametrize(
    ("direction", "name", "code"),
    [
        ("remove", "x_corrected_px", "OBS-ALREADY-CORRECTED"),
        ("apply", "x_displaced_px", "OBS-ALREADY-DISPLACED"),
    ],
)
def test_what_was_done_is_not_done_again(tmp_path, direction, name, code):
    schema = pa.schema([(name, pa.float64())])
    with pytest.raises(InputError, match=code):
        refuse_done(tmp_path, schema, direction)
    other = "apply" if direction == "remove" else "remove"
    refuse_done(tmp_path, schema, other)
    with pytest.raises(InputError, match=f"state observations.columns.x_px: {name}"):
        refuse_other_pixels(tmp_path, schema, other, COLUMNS)
    refuse_other_pixels(tmp_path, schema, direction, COLUMNS)
    refuse_other_pixels(tmp_path, schema, other, COLUMNS | {"x_px": name})


@pytest.mark.parametrize(("column", "what"), [("distance_m", "no_distance"), ("s", "no_sigma")])
def test_values_that_are_none_are_counted_and_null_is_not(tmp_path, column, what):
    """Of zero, -1, infinity, 5 and null: a slant range of zero is none, a sigma of zero is one."""
    values = [0.0, -1.0, math.inf, 5.0, None]
    table = {"image": ["a"] * 5, "point": ["p"] * 5, "x_px": [1.0] * 5, "y_px": [2.0] * 5}
    pq.write_table(pa.table(table | {column: values}), tmp_path / "o.parquet")
    named = COLUMNS | ({"distance_m": "distance_m"} if column == "distance_m" else {})
    sigma = "s" if column == "s" else None
    observations = open_observations(
        tmp_path / "o.parquet", named, None, Ledger(), sigma_column=sigma
    )
    (batch,) = observations.batches(10)
    assert getattr(batch, what) == (3 if column == "distance_m" else 2)
    read = batch.distance_m if column == "distance_m" else batch.ground_sigma
    first = math.nan if column == "distance_m" else 0.0
    np.testing.assert_array_equal(read, [first, math.nan, math.nan, 5.0, math.nan])
    assert batch.users[column].to_pylist() == values  # as they came


TEXT = st.text(
    st.characters(codec="utf-8", exclude_characters="\0\r\n", exclude_categories=["Cs"]),
    min_size=1,
    max_size=8,
).filter(lambda text: text.strip() == text)
# Beyond 1e12 nothing was measured: such numbers are read as unknown.
NUMBER = st.floats(-1e12, 1e12, allow_subnormal=False)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(st.tuples(TEXT, NUMBER, NUMBER), min_size=1, max_size=12),
    batch_rows=st.integers(1, 5),
)
def test_observations_are_read_as_they_were_written_whatever_the_batch(tmp_path, rows, batch_rows):
    """Names of images and numbers to the last bit, from CSV as from Parquet, in their order."""
    images, x, y = map(list, zip(*rows, strict=True))
    points = [f"p{i}" for i in range(len(rows))]
    table = pa.table({"image": images, "point": points, "x_px": x, "y_px": y})
    pq.write_table(table, tmp_path / "o.parquet")
    write_csv_stream(tmp_path / "o.csv", table.schema, [table])
    for name in ("o.parquet", "o.csv"):
        observations = open_observations(tmp_path / name, COLUMNS, None, Ledger())
        assert observations.rows == len(rows)
        assert observations.images == tuple(sorted(set(images)))
        batches = list(observations.batches(batch_rows))
        full, rest = divmod(len(rows), batch_rows)
        assert [len(batch) for batch in batches] == [batch_rows] * full + [rest] * (rest > 0)
        assert [i for batch in batches for i in batch.image.to_pylist()] == images
        assert [i for batch in batches for i in batch.point.to_pylist()] == points
        assert [i for batch in batches for i in batch.x_given_px.tolist()] == x
        assert [i for batch in batches for i in batch.y_px.tolist()] == y


def test_events_of_gps_weeks_and_lines_of_bad_rows(tmp_path):
    """2300 weeks after 1980-01-06 is 2024-02-04; 18 leap seconds. Line 1 holds the names."""
    path = tmp_path / "events.csv"
    path.write_text(
        "image,week,seconds\na,2300,18.5\nb,2300,-1\nc,2300,604801\nd,0,5\ne,2300,604800\n"
    )
    ledger = Ledger()
    columns = {"image": "image", "gps_week": "week", "gps_seconds": "seconds"}
    table = read_events(path, columns, ledger)
    assert table.image.tolist() == ["a", "e"]
    sunday = np.datetime64("2024-02-04T00:00:00", "ns").astype(np.int64)
    assert (table.time_ns - sunday).tolist() == [500_000_000, (604_800 - 18) * 10**9]
    assert [(e.kind, e.code, e.count) for e in ledger] == [("loss", "EVENTS-TIME", 3)]
    assert "first in line 3" in next(iter(ledger)).what


def test_sigmas_of_the_profile_each_in_its_column():
    """2 K at every edge of the layers and nothing else: 2 K at any height."""
    k = US.layers.edge.size
    matrix = np.zeros((2 * k + 1, 2 * k + 1))
    matrix[:k, :k] = 4.0
    covariance = ProfileCovariance(US, 0.0, matrix)
    table = table_of_profile(
        unadjusted(US, "a test"), "flight", [1000.0, 4000.0], TimedProfile(None, US, covariance)
    )
    assert table["sigma_temperature_k"].to_pylist() == pytest.approx([2.0, 2.0])
    # dN / N = -dT / T at one pressure: 2 of 281.65 K at 1 km, less what the column below adds,
    # g / (R T) 1 km = 0.12 of it; at 4 km 2 of 262.2 K, less 0.49 of it.
    ratio = np.array(table["sigma_refractivity"]) / np.array(table["refractivity"])
    assert ratio == pytest.approx([2.0 / 281.65 * 0.88, 2.0 / 262.2 * 0.51], rel=0.05)


@pytest.mark.parametrize("batch_rows", [1, 4, 7, 100])
def test_batches_are_of_one_size_wherever_the_reader_cuts(tmp_path, monkeypatch, batch_rows):
    """A CSV that is read in blocks of three rows or so."""
    monkeypatch.setattr(delimited, "_BLOCK_BYTES", 64)
    rows = [f"image_{i % 3},p{i},{i}.5,{2 * i}.25" for i in range(31)]
    (tmp_path / "o.csv").write_text("\n".join(["image,point,x_px,y_px", *rows]) + "\n")
    observations = open_observations(tmp_path / "o.csv", COLUMNS, None, Ledger())
    batches = list(observations.batches(batch_rows))
    sizes = [len(batch) for batch in batches]
    full, rest = divmod(31, batch_rows)
    assert sizes == [batch_rows] * full + [rest] * (rest > 0)
    assert np.concatenate([batch.x_px for batch in batches]).tolist() == [
        i + 0.5 for i in range(31)
    ]


@pytest.mark.parametrize("name", ["o.csv", "o.parquet", "block"])
def test_a_range_of_parts_is_what_the_whole_has_there(tmp_path, monkeypatch, name):
    """From a CSV cut in blocks of three rows, row groups of 4 (one of them empty), and a block."""
    monkeypatch.setattr(delimited, "_BLOCK_BYTES", 64)
    table = pa.table(
        {
            "image": [f"image_{i % 3}" for i in range(31)],
            "point": [f"p{i}" for i in range(31)],
            "x_px": np.arange(31.0),
            "y_px": np.arange(31.0) / 7,
            "own": np.arange(31),
        }
    )
    if name == "o.csv":
        write_csv_stream(tmp_path / name, table.schema, [table])
    elif name == "o.parquet":
        with pq.ParquetWriter(tmp_path / name, table.schema) as writer:
            for first in (0, 12, 30):
                writer.write_table(table.slice(first, {0: 12, 12: 18, 30: 1}[first]), 4)
                writer.write_table(table.slice(0, 0))
    else:
        (tmp_path / name).mkdir()
        (tmp_path / name / "cameras.txt").write_text("1 SIMPLE_PINHOLE 99 99 50 49 49\n")
        points = " ".join(f"{i}.5 {i}.25 {i}" for i in range(9))
        (tmp_path / name / "images.txt").write_text(
            "".join(f"{k} 1 0 0 0 0 0 {k} 1 {k}.jpg\n{points}\n" for k in range(1, 4))
        )
        (tmp_path / name / "points3D.txt").write_text(
            "".join(f"{i} 0 0 {i} 0 0 0 1 1 {i} 2 {i} 3 {i}\n" for i in range(9))
        )
    form = "colmap" if name == "block" else None
    opened = open_observations(tmp_path / name, COLUMNS, None, Ledger(), file_format=form)
    whole = list(opened.batches(4))
    for first in range(len(whole) + 1):
        for stop in (*range(first, len(whole) + 1), None):
            some = list(opened.batches(4, first, stop))
            assert len(some) == len(whole[first:stop])
            for found, batch in zip(some, whole[first:stop], strict=True):
                assert found.first_row == batch.first_row
                assert found.image.equals(batch.image)
                assert found.point.equals(batch.point)
                assert found.x_px.tolist() == batch.x_px.tolist()
                assert {k: v.to_pylist() for k, v in found.users.items()} == {
                    k: v.to_pylist() for k, v in batch.users.items()
                }


def test_floats_are_split_by_bytes_and_all_else_has_a_dictionary(tmp_path):
    table = pa.table(
        {
            "wide": np.linspace(0.0, 1.0, 1000),
            "narrow": np.linspace(0.0, 1.0, 1000, dtype=np.float32),
            "name": [f"p{i % 9}" for i in range(1000)],
            "count": np.arange(1000) % 7,
            "pair": [{"a": 1.5, "b": "x"}] * 1000,
        }
    )
    write_parquet(table, tmp_path / "table.parquet")
    with pq.ParquetFile(tmp_path / "table.parquet", page_checksum_verification=True) as file:
        assert file.read().equals(table)
        group = file.metadata.row_group(0)
    columns = [group.column(i) for i in range(group.num_columns)]
    split = {c.path_in_schema: "BYTE_STREAM_SPLIT" in c.encodings for c in columns}
    assert split == {
        "wide": True,
        "narrow": True,
        "name": False,
        "count": False,
        "pair.a": False,
        "pair.b": False,
    }
    assert {c.path_in_schema for c in columns if c.has_dictionary_page} >= {"name", "count"}
    assert not any(c.has_dictionary_page for c in columns if split[c.path_in_schema])


def test_what_was_read_of_a_large_table_does_not_stay_in_memory(tmp_path):
    path = tmp_path / "large.parquet"
    rows = 400_000
    numbers = np.random.default_rng(0).uniform(0.0, 1000.0, (2, rows))
    names = pa.array(["a"] * rows)
    columns = {"image": names, "point": names, "x_px": numbers[0], "y_px": numbers[1]}
    pq.write_table(pa.table(columns), path, row_group_size=10_000)
    observations = open_observations(path, COLUMNS, None, Ledger())
    before = pa.total_allocated_bytes()
    most = 0
    for _ in observations.batches(10_000):
        most = max(most, pa.total_allocated_bytes() - before)
    assert most < path.stat().st_size / 2
