"""Tables of one rotor whose rows no propeller gives: refused with the line, a maker's sound sheet is not."""

from pathlib import Path

import pytest
from case_table import case_table

from coaxlink.data.single import read_single_table
from coaxlink.errors import InputError

DIAMETER_M = 0.66
RPM = range(1000, 5001, 500)


def sheet(*, electrical=False, **changed):
    """A propeller of 0.66 m, figure of merit 0.6; `changed`: by line, the cells there."""
    head = "RPM,Thrust (N)," + ("Power (W)" if electrical else "Torque (N m)")
    lines = [head]
    for rpm in RPM:
        thrust, moment = 158.0 * (rpm / 5000) ** 2, 5.9 * (rpm / 5000) ** 2
        lines.append(f"{rpm},{thrust:.4f},{moment * rpm * 0.10472 / 0.75 if electrical else moment:.4f}")
    for line, cells in changed.items():
        lines[int(line.removeprefix("line")) - 1] = cells
    return "\n".join(lines) + "\n"


def test_rows_that_no_propeller_gives_are_refused_with_their_line(tmp_path: Path) -> None:
    path = tmp_path / "sheet.csv"
    with case_table() as case:
        for name, text, expected in (
            ("a point lost in the torque", sheet(line6="3500,77.42,28910"), "line 6: 77.42 N for"),
            ("two rows in one", sheet(line10="5000,80.0,5.9"), "line 10: 80 N at 5000 rpm"),
            ("no power for its thrust", sheet(line8="4000,101.1,1.1"), "line 8: .* figure of merit of"),
            ("electrical", sheet(electrical=True, line8="4000,101.1,300"), "line 8: .*electrical power"),
            ("electrical", sheet(electrical=True, line8="4000,101.1,90000"), "line 8: .*electrical power"),
        ):
            path.write_text(text)
            with case(f"{name}: {expected}"), pytest.raises(InputError, match=expected):
                read_single_table(path, DIAMETER_M)
        for text in (sheet(), sheet(electrical=True), sheet(electrical=True, line2="1000,6.32,60")):
            with case(text):
                path.write_text(text)
                assert len(read_single_table(path, DIAMETER_M).rpm) == len(RPM)
