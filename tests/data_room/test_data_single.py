"""Tables of one rotor whose rows no propeller gives: refused with the line, a maker's sound sheet is not."""

from pathlib import Path

import pytest
from case_table import case_table

from coaxlink.data.single import read_single_table
from coaxlink.data.stand import read_stand_log
from coaxlink.errors import InputError
from coaxlink.rotor.pair_sum import pair_sum

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


ROWS = [(n, 7.46e-7 * n**2, 1.479e-8 * n**2) for n in range(2000, 7000, 500)]  # rpm, N, N m of 0.381 m
STAND = "Time (s),Motor Optical Speed (RPM),Thrust (N),Torque (N\u00b7m),ESC (\u00b5s)\n" + "".join(
    f"{i},{n},{t:.4f},{q:.5f},{1100 + 50 * i}\n" for i, (n, t, q) in enumerate(ROWS)
)
COEFFICIENTS = [(n, 0.104, 0.0340) for n, *_ in ROWS]  # those of ROWS
UIUC = "# static\u00b0\n  RPM     CT     CP\n" + "".join(f"{n} {t:.4f} {p:.4f}\n" for n, t, p in COEFFICIENTS)
APC = "  15x5 \u00b0\n" + "".join(
    f" PROP RPM = {n}\n V J Pe Ct Cp\n (mph) (-) (-) (-) (-)\n 0.0 0.0 0.0 {t} {p}\n 5.0 0.1 0.2 .09 .03\n\n"
    for n, t, p in COEFFICIENTS
)


def commas(text: str) -> str:
    """As a spreadsheet of another country writes it."""
    return text.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16", "utf-16-le"])
@pytest.mark.parametrize("text", [STAND, commas(STAND), UIUC, commas(UIUC), APC, commas(APC)])
def test_tables_are_read_however_their_text_is_written(tmp_path: Path, text: str, encoding: str) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(text.encode(encoding))
    table = read_single_table(path, 0.381)
    assert table.rpm.tolist() == [n for n, *_ in ROWS]
    assert table.thrust_N == pytest.approx([t for _, t, _ in ROWS], rel=0.05)
    assert table.torque_Nm == pytest.approx([q for *_, q in ROWS], rel=0.05)


def test_rows_that_end_early_are_read_and_a_row_that_was_cut_is_not(tmp_path: Path) -> None:
    head, *rows = STAND.splitlines()
    path = tmp_path / "log.csv"
    path.write_text("\n".join([head + ",TargetRPM,P", *rows[:6], *(row + ",6000,0.1" for row in rows[6:])]))
    table = read_single_table(path, 0.381)
    assert len(table.rpm) == len(ROWS)
    assert "6 rows end before the heading does; empty there: TargetRPM, P" in table.notes
    path.write_text("\n".join([head, *rows[:5], rows[5][:-8], *rows[6:]]))
    with pytest.raises(InputError, match="line 7: 5 columns are expected, found 4"):
        read_single_table(path, 0.381)


def test_the_pairs_cell_is_the_upper_rotors_where_the_lower_one_stands(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    head = "Time (ms),Top Motor Speed (rpm),Bottom Motor Speed (rpm),Thrust (N)\n"
    path.write_text(head + "".join(f"{250 * i},{n},0,{t:.4f}\n" for i, (n, t, _) in enumerate(ROWS)))
    assert read_single_table(path, 0.381).thrust_N == pytest.approx([t for _, t, _ in ROWS], rel=1e-3)


def test_the_rotor_that_turns_alone_is_the_table_whichever_it_is(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    head = "Time (ms),Top Motor Speed (rpm),Bottom Motor Speed (rpm),Thrust (N)\n"
    with case_table() as case:
        for sign in (1, -1):
            with case(f"{sign}"):
                path.write_text(
                    head + "".join(f"{250 * i},0,{n},{sign * t:.4f}\n" for i, (n, t, _) in enumerate(ROWS))
                )
                read = read_single_table(path, 0.381)
                assert read.rpm == pytest.approx([n for n, *_ in ROWS])
                assert read.thrust_N == pytest.approx([t for _, t, _ in ROWS], rel=1e-3)
                assert "the lower rotor turns alone in it" in read.notes
        with case("both turn"):
            path.write_text(
                head + "".join(f"{250 * i},{n},{n},{t:.4f}\n" for i, (n, t, _) in enumerate(ROWS))
            )
            with pytest.raises(InputError, match="found two that turn"):
                read_single_table(path, 0.381)
        with case("a pair's model"):
            path.write_text(head + "".join(f"{250 * i},0,{n},{t:.4f}\n" for i, (n, t, _) in enumerate(ROWS)))
            with pytest.raises(InputError, match="the upper one stands still in all of them"):
                pair_sum(read_stand_log(path))
