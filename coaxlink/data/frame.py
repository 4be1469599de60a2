"""Samples to and from a pandas DataFrame; pandas is optional and loads here alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coaxlink.errors import InputError

if TYPE_CHECKING:
    import pandas

TIME = "time_s"


def dataframe(columns: dict[str, NDArray[np.float64]], about: dict[str, Any]) -> pandas.DataFrame:
    """A DataFrame of the columns, `about` in its attrs. Raises InputError without pandas."""
    frame = _pandas().DataFrame(columns)
    frame.attrs.update(about)
    return frame


def columns_of(frame: pandas.DataFrame) -> tuple[dict[str, NDArray[np.float64]], tuple[str, ...]]:
    """Columns (rows,) as floats, missing values as NaN, and remarks on what was read from the index.

    Raises InputError naming the column that holds no numbers, or whose name comes twice.
    """
    pd = _pandas()
    if not isinstance(frame, pd.DataFrame):
        raise InputError("DataFrame", "", f"a pandas DataFrame is expected, found {type(frame).__name__}")
    columns, notes = {}, []
    time = _index_time(frame, pd)
    if time is not None and TIME not in frame.columns:
        columns[TIME], note = time
        notes.append(note)
    for index, name in enumerate(frame.columns):
        if not isinstance(name, str):
            problem = f"a name with its unit is expected (upper_thrust_N), found {name!r}"
            raise InputError("DataFrame", f"column {index + 1}", problem)
        if name in columns:
            raise InputError("DataFrame", f"column {name}", "the name comes twice")
        columns[name] = _numbers(name, frame.iloc[:, index], pd)
    if not columns or not len(frame):
        raise InputError("DataFrame", "", f"rows and columns are expected, found shape {frame.shape}")
    return columns, tuple(notes)


def _numbers(name: str, column: Any, pd: Any) -> NDArray[np.float64]:
    kinds = pd.api.types
    if not (kinds.is_numeric_dtype(column) or kinds.is_bool_dtype(column)) or kinds.is_complex_dtype(column):
        raise InputError("DataFrame", f"column {name}", f"numbers are expected, found {column.dtype}")
    return np.array(column.to_numpy(dtype=np.float64, na_value=np.nan))


def _index_time(frame: Any, pd: Any) -> tuple[NDArray[np.float64], str] | None:
    """Seconds of an index that is a time, and the remark on it."""
    index = frame.index
    if index.name == TIME and pd.api.types.is_numeric_dtype(index):
        return np.array(index.to_numpy(dtype=np.float64)), "time_s is the frame's index"
    if isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex)) and len(index):
        seconds = (index - index[0]).total_seconds().to_numpy(dtype=np.float64)
        return seconds, "time_s is counted from the first entry of the frame's index of times"
    return None


def _pandas() -> Any:
    try:
        import pandas
    except ImportError as error:
        problem = "is not installed; coaxlink[pandas] brings it"
        raise InputError("pandas", "", problem) from error
    return pandas
