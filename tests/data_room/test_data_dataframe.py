"""Samples to and from pandas."""

import builtins

import numpy as np
import pandas as pd
import pytest
from case_table import case_table

from coaxlink.data import Samples
from coaxlink.errors import InputError
from coaxlink.files import example
from coaxlink.library import read_log


def test_a_log_goes_through_a_frame_and_back_unchanged():
    log = read_log(example("stand_eq17.csv"))
    frame = log.to_dataframe()
    assert list(frame.columns) == list(log.columns) and len(frame) == log.rows
    assert frame.attrs["source"] == log.source
    back = Samples.from_dataframe(frame)
    assert (back.source, back.notes, back.resolution) == (log.source, log.notes, log.resolution)
    for name in log.columns:
        np.testing.assert_array_equal(back[name], log[name])


def test_a_frame_is_a_copy():
    log = Samples({"time_s": np.arange(3.0)})
    frame = log.to_dataframe()
    frame.loc[0, "time_s"] = 99.0
    assert log["time_s"][0] == 0.0
    again = Samples.from_dataframe(frame)
    frame.loc[1, "time_s"] = 99.0
    assert again["time_s"].tolist() == [99.0, 1.0, 2.0]


def test_an_index_of_times_becomes_time_s_and_is_said():
    stamps = pd.to_datetime(["2024-05-01 10:00:00", "2024-05-01 10:00:01", "2024-05-01 10:01:00"])
    for index, seconds in (
        (pd.to_timedelta([2.0, 2.5, 4.0], unit="s"), [0.0, 0.5, 2.0]),
        (stamps, [0.0, 1.0, 60.0]),
        (pd.Index([5.0, 6.0, 7.0], name="time_s"), [5.0, 6.0, 7.0]),
    ):
        log = Samples.from_dataframe(pd.DataFrame({"upper_rpm": [1, 2, 3]}, index=index), "mine")
        assert log["time_s"].tolist() == seconds and log.source == "mine"
        assert "index" in log.notes[-1]


def test_missing_values_and_whole_numbers_are_floats():
    frame = pd.DataFrame({"upper_rpm": pd.array([1000, None], dtype="Int64"), "armed": [True, False]})
    log = Samples.from_dataframe(frame)
    assert log["upper_rpm"][0] == 1000.0 and np.isnan(log["upper_rpm"][1])
    assert log["armed"].tolist() == [1.0, 0.0]


def test_what_is_no_table_of_numbers_is_refused_by_name():
    with case_table() as case:
        for frame, reported in (
            (pd.DataFrame({"upper_rpm": ["fast"]}), "column upper_rpm: numbers are expected"),
            (pd.DataFrame({"upper_rpm": [1 + 2j]}), "column upper_rpm: numbers are expected"),
            (pd.DataFrame({"t": pd.to_datetime(["2024-05-01"])}), "column t: numbers are expected"),
            (pd.DataFrame([[1.0, 2.0]], columns=["a", "a"]), "column a: the name comes twice"),
            (pd.DataFrame([[1.0, 2.0]]), "column 1: a name with its unit is expected"),
            (pd.DataFrame({"upper_rpm": []}, dtype=float), "rows and columns are expected"),
            ({"upper_rpm": [1.0]}, "a pandas DataFrame is expected, found dict"),
        ):
            with case(reported), pytest.raises(InputError, match=reported):
                Samples.from_dataframe(frame)


def test_without_pandas_the_error_says_what_to_install(monkeypatch):
    usual = builtins.__import__

    def gone(name, *rest):
        if name == "pandas":
            raise ModuleNotFoundError("No module named 'pandas'")
        return usual(name, *rest)

    monkeypatch.setattr(builtins, "__import__", gone)
    with pytest.raises(InputError, match=r"pandas: is not installed; coaxlink\[pandas\] brings it"):
        Samples({"time_s": np.arange(3.0)}).to_dataframe()
