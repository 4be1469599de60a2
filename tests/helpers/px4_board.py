"""Parameters of a small PX4 board for the tests, written out here rather than made by the code under test."""

from scripted_autopilot import FLOAT, INT32

PLACES = [(1, 1), (1, -1), (-1, -1), (-1, 1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
SPINS = [1, -1, 1, -1, 1, -1, 1, -1]


def x8(ct_upper=6.5, ct_lower=6.5, km=0.05, fac=0.0, count=8):
    """A coaxial octorotor's CA_ table and a few others: name -> (value, type)."""
    board = {
        "CA_AIRFRAME": (0, INT32),
        "CA_METHOD": (2, INT32),
        "CA_ROTOR_COUNT": (count, INT32),
        "MC_AIRMODE": (0, INT32),
        "MPC_THR_HOVER": (0.5, FLOAT),
        "SYS_AUTOSTART": (12001, INT32),
        "THR_MDL_FAC": (fac, FLOAT),
    }
    for n in range(12):
        x, y = PLACES[n % 8]
        values = {"PX": 0.1807 * x, "PY": 0.1807 * y, "PZ": -0.075 if n < 4 else 0.075}
        values |= {"AX": 0.0, "AY": 0.0, "AZ": -1.0, "CT": ct_upper if n < 4 else ct_lower}
        values["KM"] = km * SPINS[n % 8]
        board |= {f"CA_ROTOR{n}_{key}": (value, FLOAT) for key, value in values.items()}
    return board


def params_text(ct_upper=46.98, ct_lower=69.89, count=8, **override):
    """A .params file of eq. 15 in QGC's format; override by name, None leaves a name out."""
    values = {
        name: v for name, (v, _) in x8(ct_upper, ct_lower, 0.04, 1.0, count).items() if name.startswith("CA_")
    }
    values = {
        n: v
        for n, v in values.items()
        if not n.startswith("CA_ROTOR") or n == "CA_ROTOR_COUNT" or _index(n) < count
    }
    values |= {"THR_MDL_FAC": 1.0, "MPC_THR_HOVER": 0.4} | override
    fixed = {"CA_AIRFRAME", "CA_METHOD", "CA_ROTOR_COUNT", "SYS_AUTOSTART"}
    lines = [f"1\t1\t{n}\t{v}\t{6 if n in fixed else 9}" for n, v in values.items() if v is not None]
    return "# a table\n" + "\n".join(lines) + "\n"


def _index(name):
    return int(name.removeprefix("CA_ROTOR").split("_")[0])
