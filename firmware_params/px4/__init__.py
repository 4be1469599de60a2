"""PX4: what its tables can say, and the mix it will make of them (v1.14 and later)."""

from firmware_params.errors import Finding, ParamsFileError, TableError
from firmware_params.px4.parameters import PARAMETERS, as_stored, out_of_range, type_of
from firmware_params.px4.qgc import params_text, write_params_file
from firmware_params.px4.realise import Px4Mix, effectiveness, realise
from firmware_params.px4.table import Px4Table, RotorEntry, params_to_table, table_to_params

__all__ = [
    "PARAMETERS",
    "Finding",
    "ParamsFileError",
    "Px4Mix",
    "Px4Table",
    "RotorEntry",
    "TableError",
    "as_stored",
    "effectiveness",
    "out_of_range",
    "params_text",
    "params_to_table",
    "realise",
    "table_to_params",
    "type_of",
    "write_params_file",
]
