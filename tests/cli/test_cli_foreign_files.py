"""`coaxlink identify` on files as stands write them, after real headings: the right rotor or a refusal.

Headings: Tyto 1780, Flight Stand, RCbenchmark 1585, Buzzatto and Liarokapis, pyBEMT, spreadsheets, loggers.
Right means: thrust and torque of the written model within 5 per cent of the law, over the speeds measured.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from case_table import case_table
from stand_files import SIDES, UNITS, Array, Pair, equal, grid, readings, table, write
from workbook import workbook

from coaxlink.cli import build_app
from coaxlink.cli.shared.shell import run
from coaxlink.rotor import load_rotor_model

PAIR = Pair(0.38, 0.09, 0.65, 6500.0)
RPM = {"upper": PAIR.top_rpm, "lower": PAIR.top_rpm}
U, V = grid()
SEEN = readings(PAIR, U, V, 7, noise=0.004)
Make = Callable[[Path], Path]
CRM = ("--form", "crm", "--max-order", "2")
RIGHT, REFUSED, STATED = 0, 2, 10  # stated: done as told, the doubt is said


def coaxlink(*arguments: object) -> int:
    return run(build_app(), [str(a) for a in arguments])


def off(rotor: Path, u: Array = U, v: Array = V, alone: bool = False, throttle: bool = False) -> float:
    """Greatest error of a written model over the measured speeds, share of the greatest load."""
    model = load_rotor_model(rotor)
    true = PAIR.loads(u, np.zeros_like(u) if alone else v)
    scale = 1.0 if throttle else PAIR.top_rpm / model.speed_max_rpm
    if throttle:
        u, v = 0.1 + 0.85 * u, 0.1 + 0.85 * v
    loads = model.loads(scale * u, 0.0 * v if alone else scale * v)
    return max(
        float(np.abs(getattr(loads, name) - x).max() / np.abs(x).max())
        for name, x in true.items()
        if not (alone and name.startswith("lower"))
    )


def pick(
    names: dict[str, str], given: dict[str, Array] = SEEN, **scale: float
) -> dict[str, Array | list[str]]:
    """Columns by heading; `scale` by quantity or whole name (upper_torque=-1)."""
    return {
        heading: given[name] * scale.get(name.split("_")[1], 1.0) * scale.get(name, 1.0)
        for heading, name in names.items()
    }


def tyto_1780(upper: str, lower: str) -> dict[str, str]:
    names = {}
    for letter in "AB":
        side = "upper" if letter == upper else "lower"
        names |= {
            f"ESC {letter} (µs)": f"{side}_throttle",
            f"Torque {letter} (N·m)": f"{side}_torque",
            f"Thrust {letter} (N)": f"{side}_thrust",
            f"Voltage {letter} (V)": f"{side}_voltage",
            f"Current {letter} (A)": f"{side}_current",
            f"Motor Optical Speed {letter} (RPM)": f"{side}_speed",
        }
    return names


def with_us(columns: dict[str, Array | list[str]], mark: str = "ESC") -> dict[str, Array | list[str]]:
    return {k: 1000 + 1000 * np.asarray(x) if mark in k else x for k, x in columns.items()}


def file_1780(upper: str) -> Make:
    def make(folder: Path) -> Path:
        names = tyto_1780(upper, "B" if upper == "A" else "A")
        columns: dict[str, Array | list[str]] = {"Time (s)": np.arange(len(U)) * 0.5}
        columns |= with_us(pick(names, lower_torque=-1.0))
        for letter in "AB":
            side = "upper" if letter == upper else "lower"
            shaft = SEEN[f"{side}_torque"] * SEEN[f"{side}_speed"] * np.pi / 30
            columns[f"Mechanical Power {letter} (W)"] = shaft
            columns[f"Overall Efficiency {letter} (N/W)"] = 0 * shaft + 0.08
        columns["App message"] = [""] * len(U)
        return write(folder / "1780.csv", "\ufeff" + table(columns).replace("\n", ",\n"))

    return make


def flight_stand(folder: Path) -> Path:
    columns: dict[str, Array | list[str]] = {"Time (s)": np.arange(len(U)) * 0.1}
    for number, side in (("1", "lower"), ("2", "upper")):
        name = f"Powertrain {number} - "
        columns |= {
            f"{name}ESC throttle (μs)": 1000 + 1000 * SEEN[f"{side}_throttle"],
            f"{name}force Fx (N)": 0.1 + 0 * U,
            f"{name}force Fz (thrust) (kgf)": SEEN[f"{side}_thrust"] / 9.80665,
            f"{name}torque MX (N⋅m)": 0.01 + 0 * U,
            f"{name}torque MZ (torque) (N⋅m)": SEEN[f"{side}_torque"],
            f"{name}rotation speed (rad/s)": SEEN[f"{side}_speed"] * np.pi / 30,
            f"{name}voltage (V)": SEEN[f"{side}_voltage"],
            f"{name}current (A)": SEEN[f"{side}_current"],
            f"{name}motor & ESC efficiency (%)": 78 + 0 * U,
            f"{name}propeller efficiency (gf/W)": 8 + 0 * U,
        }
    return write(folder / "flightstand.csv", table(columns))


ALONE_U = np.linspace(0.25, 1, 30)
ALONE = readings(PAIR, ALONE_U, 0 * ALONE_U, 3, noise=0.004)


def rcbenchmark_1585(unit: str, written: str) -> Make:
    def make(folder: Path) -> Path:
        head = {"Time (s)": np.arange(30.0), "ESC signal (µs)": 1000 + 1000 * ALONE["upper_throttle"]}
        empty = {f"Servo {i} (µs)": [""] * 30 for i in (1, 2, 3)}
        rest = {
            "AccX (g)": 0.01 + 0 * ALONE_U,
            "Torque (N·m)": -ALONE["upper_torque"],
            f"Thrust ({written})": ALONE["upper_thrust"] * UNITS["thrust"][unit],
            "Voltage (V)": ALONE["upper_voltage"],
            "Current (A)": ALONE["upper_current"],
            "Motor Electrical Speed (RPM)": 0 * ALONE_U,
            "Motor Optical Speed (RPM)": ALONE["upper_speed"],
            "Vibration (g)": 0.05 + 0 * ALONE_U,
            "App message": [""] * 30,
        }
        return write(folder / "1585.csv", table(head | empty | rest))

    return make


def buzzatto(folder: Path) -> Path:
    names = {}
    for hand, side in (("Left", "upper"), ("Right", "lower")):
        names |= {
            f"PWM {hand}": f"{side}_throttle",
            f"Thrust {hand} [g]": f"{side}_thrust",
            f"Torque {hand} [Nm]": f"{side}_torque",
            f"Voltage {hand} [V]": f"{side}_voltage",
            f"Current {hand} [A]": f"{side}_current",
            f"Speed {hand} [rpm]": f"{side}_speed",
        }
    columns = with_us(pick(names, thrust=1000 / 9.80665, upper_torque=-1.0), "PWM")
    rest = {
        k: np.concatenate([[1000.0 if "PWM" in k else 0.0] * 2, np.asarray(x)]) for k, x in columns.items()
    }
    rest["Total Thrust [g]"] = rest["Thrust Left [g]"] + rest["Thrust Right [g]"]
    return write(folder / "platform.csv", table(rest))


EQ_U, EQ_V = equal()
EQUAL = readings(PAIR, EQ_U, EQ_V, 5, noise=0.004)


def pybemt(torque: bool) -> Make:
    def make(folder: Path) -> Path:
        names = {
            "RPM": "lower_speed",
            "T_A(N)": "lower_thrust",
            "T_B(N)": "upper_thrust",
            "RPM_B": "upper_speed",
        }
        if torque:
            names |= {"Q_A(Nm)": "lower_torque", "Q_B(Nm)": "upper_torque"}
        return write(folder / "pybemt.csv", table(pick(names, EQUAL)))

    return make


def pybemt_alone(folder: Path) -> Path:
    columns = {
        "RPM": ALONE["upper_speed"],
        "omega": ALONE["upper_speed"] * np.pi / 30,
        "T(gf)": ALONE["upper_thrust"] * 1000 / 9.80665,
        "T(N)": ALONE["upper_thrust"],
        "Q(Nm)": ALONE["upper_torque"],
        "P(W)": ALONE["upper_torque"] * ALONE["upper_speed"] * np.pi / 30,
    }
    return write(folder / "alone.csv", "\ufeff" + table(columns, ";"))


def named(form: str, quantities: dict[str, tuple[str, str]], upper: str, lower: str) -> dict[str, str]:
    """Headings of both rotors: what each quantity is called, and in which unit."""
    return {
        form.format(what=what, side=label, unit=unit): f"{side}_{quantity}"
        for label, side in ((upper, "upper"), (lower, "lower"))
        for quantity, (what, unit) in quantities.items()
    }


GERMAN = named(
    "{what} {side} ({unit})",
    {"speed": ("Drehzahl", "1/min"), "thrust": ("Schub", "N"), "torque": ("Drehmoment", "Nm")},
    "oben",
    "unten",
)
HOME = named(
    "{what}{side}{unit}",
    {"speed": ("rpm", ""), "thrust": ("thrust", "_g"), "torque": ("torque", "_Ncm")},
    "2",
    "1",
)
IMPERIAL = named(
    "{what} {side} {unit}",
    {"speed": ("RPM", ""), "thrust": ("Thrust", "(oz)"), "torque": ("Torque", "(in-oz)")},
    "top",
    "bottom",
)
LBF = named(
    "{side} {what} ({unit})",
    {"speed": ("speed", "rev/s"), "thrust": ("force", "lbf"), "torque": ("moment", "lbf-in")},
    "rear",
    "front",
)
OWN = named(
    "{side}_{what}{unit}",
    {"speed": ("rpm", ""), "thrust": ("thrust", "_N"), "torque": ("torque", "_Nm")},
    "upper",
    "lower",
)


def plain(names: dict[str, str], file: str = "log.csv", mark: str = ",", comma: bool = False,
          encoding: str = "utf-8", wrap: Callable[[str], str] = str, **scale: float) -> Make:  # fmt: skip
    def make(folder: Path) -> Path:
        return write(folder / file, wrap(table(pick(names, **scale), mark, comma)), encoding)

    return make


def messy(text: str) -> str:
    head, *lines = text.splitlines()
    middle = [head, "", "# the second sweep", "// with a new battery"]
    return "\r\n".join(["Stand 3, 15 in", "", head, *lines[:20], *middle, *lines[20:], ""])


def grouped(text: str) -> str:
    _, *lines = text.splitlines()
    return (
        "\n".join(["Upper,,,Lower,,", "rpm,Thrust (N),Torque (N m),rpm,Thrust (N),Torque (N m)", *lines])
        + "\n"
    )


def units_below(text: str) -> str:
    _, *lines = text.splitlines()
    head = "n top,F top,M top,n bottom,F bottom,M bottom".replace("n ", "Speed ").replace("F ", "Force ")
    return "\n".join([head.replace("M ", "Torque "), "[1/min],[kgf],[N cm]," * 2, *lines]) + "\n"


def duty(folder: Path) -> Path:
    columns = {
        f"{what} {side} ({unit})": SEEN[f"{side}_{quantity}"] * factor
        for side in SIDES
        for what, unit, quantity, factor in (
            ("Duty", "%", "throttle", 100.0),
            ("Thrust", "N", "thrust", 1.0),
            ("Torque", "Nm", "torque", 1.0),
        )
    }
    return write(folder / "duty.csv", table(columns))


TURNED = {k: {"upper": "lower", "lower": "upper"}[v[:5]] + v[5:] for k, v in OWN.items()}
CROSSED = {**OWN, "upper_thrust_N": "lower_thrust", "lower_thrust_N": "upper_thrust"}
HOME_UNITS = {"thrust": 1000 / 9.80665, "torque": 100.0}
ERPM = {k.replace("rpm", "erpm"): v for k, v in HOME.items()}
KGF = {k.replace("thrust_N", "thrust_kgf"): v for k, v in OWN.items()}
THREE = HOME | {"rpm3": "upper_speed", "thrust3_g": "upper_thrust"}
POUNDS = {"speed": 1 / 60, "thrust": 0.22480894, "torque": 8.8507458}
OUNCES = {"thrust": 3.5969431, "torque": 141.61193}
CUT = plain(OWN, wrap=messy)
FILES: dict[str, tuple[Make, tuple[str, ...], int, str]] = {
    "Tyto 1780, A above": (file_1780("A"), (), RIGHT, "'A' is the upper rotor, by the data"),
    "Tyto 1780, B above": (file_1780("B"), (), RIGHT, "'B' is the upper rotor, by the data"),
    "Tyto 1780, said wrong": (file_1780("B"), ("--upper", "A"), STATED, "against --upper A"),
    "Flight Stand, two powertrains": (flight_stand, (), RIGHT, "'2' is the upper rotor"),
    "RCbenchmark 1585 in gf": (rcbenchmark_1585("gf", "gf"), (), RIGHT, "one rotor"),
    "RCbenchmark 1585 in lbf": (rcbenchmark_1585("lbf", "lbf"), (), RIGHT, "one rotor"),
    "kgf under N": (rcbenchmark_1585("kgf", "N"), (), REFUSED, 'the thrust times 4.7 to 15'),
    "g under kgf": (rcbenchmark_1585("gf", "kgf"), (), REFUSED, 'the thrust times 0.00047 to 0.0015'),
    "Buzzatto": (buzzatto, (), RIGHT, "'left' is the upper rotor"),
    "pyBEMT coaxial": (pybemt(True), (), RIGHT, "'B' is the upper rotor"),
    "pyBEMT coaxial without torque": (pybemt(False), (), REFUSED, "--upper A or --upper B"),
    "pyBEMT alone": (pybemt_alone, (), RIGHT, "one rotor"),
    "German spreadsheet": (plain(GERMAN, mark=";", comma=True, encoding="latin-1"), (), RIGHT, "comma"),
    "Excel's Unicode text": (plain(GERMAN, mark="\t", encoding="utf-16"), (), RIGHT, ""),
    "home-made, numbered": (plain(HOME, **HOME_UNITS), (), RIGHT, "'2' is the upper rotor"),
    "imperial": (plain(IMPERIAL, **OUNCES), (), RIGHT, ""),
    "front and rear in pounds": (plain(LBF, **POUNDS), (), RIGHT, "'rear' is the upper rotor"),
    "electrical turns": (plain(ERPM, speed=7.0, **HOME_UNITS), ("--poles", "14"), RIGHT, ""),
    "electrical turns, no poles": (plain(ERPM, speed=7.0, **HOME_UNITS), (), REFUSED, "--poles"),
    "numpy.savetxt": (plain(OWN, mark=" ", wrap=lambda t: f"# {t}"), (), RIGHT, ""),
    "group headings": (plain(OWN, wrap=grouped), (), RIGHT, "put together"),
    "interrupted and commented": (CUT, (), RIGHT, "headings repeated"),
    "units below the headings": (
        plain(OWN, wrap=units_below, thrust=1 / 9.80665, torque=100.0), (), RIGHT, "units on line 2"
    ),
    "ours in kgf": (plain(KGF, thrust=1 / 9.80665), (), RIGHT, ""),
    "duty without speeds": (duty, (), RIGHT, "throttle is taken"),
    "ours, exchanged": (plain(TURNED), (), REFUSED, "look exchanged"),
    "ours, exchanged and said": (plain(TURNED), ("--upper", "lower"), RIGHT, "as --upper lower says"),
    "one torque turned": (plain(OWN, lower_torque=-1.0), (), REFUSED, "scale = -1"),
    "thrusts exchanged": (plain(CROSSED), (), REFUSED, "look exchanged"),
    "three rotors": (plain(THREE, **HOME_UNITS), (), REFUSED, "3 rotors"),
}  # fmt: skip


@pytest.mark.slow
def test_the_right_rotor_or_a_refusal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with case_table() as case:
        for number, (name, (make, options, expected, words)) in enumerate(FILES.items()):
            folder = tmp_path / str(number)
            folder.mkdir()
            out = folder / "rotor.toml"
            code = coaxlink("identify", make(folder), *CRM, "--all", "--out", out, *options)
            reported = capsys.readouterr().err
            with case(name):
                assert code == expected % 10 and words in reported, reported
                assert out.exists() == (code == 0)
                if expected == RIGHT and "one rotor" in words:
                    assert off(out, ALONE_U, 0 * ALONE_U, alone=True) < 0.05
                elif expected == RIGHT and "pyBEMT" in name:
                    assert off(out, EQ_U, EQ_V) < 0.05
                elif expected == RIGHT:
                    assert off(out, throttle="duty" in name) < 0.05


@pytest.mark.slow
def test_numbers_without_units_are_right_or_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {f"{s}{number}": f"{side}_{q}" for number, side in ((1, "upper"), (2, "lower"))
             for s, q in (("T", "thrust"), ("Q", "torque"), ("rpm", "speed"))}  # fmt: skip
    for unit, factor in UNITS["thrust"].items():
        out = tmp_path / f"{unit}.toml"
        code = coaxlink(
            "identify",
            plain(names, thrust=factor)(tmp_path),
            "--form",
            "crm",
            "--max-order",
            "2",
            "--out",
            out,
        )
        reported = capsys.readouterr().err
        assert (code == 2 and "unit of a" in reported) or (code == 0 and off(out) < 0.05)


@pytest.mark.slow
def test_a_sheet_of_a_workbook(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    columns = pick(HOME, **HOME_UNITS)
    rows = [list(columns), *([float(x) for x in row] for row in zip(*columns.values(), strict=True))]
    book, out = tmp_path / "log.xlsx", tmp_path / "rotor.toml"
    book.write_bytes(workbook({"Monday": rows, "Tuesday": rows}))
    assert coaxlink("identify", book) == 2
    assert "name one with --sheet (Monday, Tuesday)" in capsys.readouterr().err
    assert coaxlink("identify", book, "--sheet", "Tuesday", *CRM, "--out", out) == 0
    assert off(out) < 0.05
