"""Times and places of tables that no survey can have: unknown, and said."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from unbend.atmosphere.soundings.levels import first_stated
from unbend.config.dates import checked_date
from unbend.config.section import SectionError
from unbend.messages import Ledger
from unbend.tables.imports.stated import channel_of_rows
from unbend.tables.text_columns import utc_of_columns, utc_of_dates


@pytest.mark.parametrize(
    "text",
    [
        "2015",  # a year alone was its first of January
        "1200",  # wrapped to 1784
        "2262-05-01T00:00:00Z",  # wrapped to 1677
        "2099-03-12T12:00:00Z",
        "1970-01-01T00:00:05Z",
        "1980-01-06T00:00:00Z",
        "12/03/2015 12:00:00",
    ],
)
def test_what_no_survey_can_have_is_no_time(text):
    _, good = utc_of_dates(pd.Series([text, "2015-03-12T12:00:00Z"]))
    assert good.tolist() == [False, True]


@pytest.mark.parametrize(
    "text",
    ["1956-04-12T10:00:00Z", "2015/3/2 12:00:00", "20150312T120000", "2015-03-12T13:00+01:00"],
)
def test_dates_of_surveys_are_read(text):
    _, good = utc_of_dates(pd.Series([text]))
    assert good.all()


def test_a_gps_week_modulo_1024_is_unknown():
    table = pd.DataFrame({"week": ["2395", "347"], "seconds": ["1000", "1000"]})
    _, good = utc_of_columns(table, {"gps_week": "week", "gps_seconds": "seconds"})
    assert good.tolist() == [True, False]


def test_a_row_at_zero_zero_is_no_place_and_one_without_a_height_is_kept():
    time_ns = (1_700_000_000 + np.arange(3)) * 10**9
    columns = {"lat_rad": np.array([0.0, 0.8, 0.8]), "lon_rad": np.array([0.0, 0.1, 0.1])}
    columns["h_msl_m"] = np.array([0.0, 900.0, np.nan])
    ledger = Ledger()
    readable = np.ones(3, np.bool_)
    channel = channel_of_rows(Path("track.csv"), "CSV", time_ns, columns, ledger, readable=readable)
    assert channel["lat_rad"].tolist() == [0.8, 0.8]
    assert [(entry.code, entry.count) for entry in ledger] == [("IMPORT-ROWS", 1)]


def test_a_mission_date_in_the_future_is_refused():
    with pytest.raises(SectionError, match="future"):
        checked_date("2126-05-14")
    assert checked_date("2026-05-14") == "2026-05-14"


def test_a_column_is_stated_by_its_first_field_that_is_not_empty():
    assert first_stated(["", "nan", "46.35"]) == "46.35"
    assert first_stated(["", "-9999"]) == ""
