"""docs/no_stand.md: an afternoon without a stand, a maker's table to a flown and judged model."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from coaxlink.cli import main
from coaxlink.mavlink import connect
from coaxlink.mavlink.parameters import Parameters
from coaxlink.rotor import load_rotor_model
from sim.testing import standin

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "no_stand.md"
URL = "udpin:0.0.0.0:14550"
# the paper's pair, with a full speed at which its thrust and torque are those of 18.5 x 6.3 in propellers
MAX_RPM = 7500.0
REAL = 9  # MAVLink's type of a float parameter


def packs():
    """The lines of every block under <!-- run -->, by the pack they are flown on: the last has its own."""
    found = re.findall(r"<!-- run -->\n```sh\n(.*?)```", PAGE.read_text(), re.DOTALL)
    blocks = [[line for line in block.splitlines() if line.strip()] for block in found]
    return [[line for block in blocks[:-1] for line in block], blocks[-1]]


def write_world(folder):
    """The rotors that are true there, and what their maker's sheet says of one of them."""
    text = (ROOT / "examples" / "rotor_paper.toml").read_text()
    (folder / "world.toml").write_text(re.sub(r"speed_max_rpm = [\d.]+", f"speed_max_rpm = {MAX_RPM}", text))
    rows = ["Throttle,Voltage (V),Thrust (g),Torque (N*m),RPM,Power (W)"]
    for throttle in range(40, 101, 10):
        u = throttle / 100
        thrust, torque = 55.9517 * u**2 + 22.4464 * u, 1.2437 * u**2 + 0.7155 * u
        rpm = MAX_RPM * u
        power = torque * rpm * np.pi / 30 / 0.82
        rows.append(f"{throttle}%,44.4,{thrust / 9.80665e-3:.0f},{torque:.3f},{rpm:.0f},{power:.0f}")
    (folder / "maker.csv").write_text("\n".join(rows) + "\n")


@pytest.mark.timeout(1800)
def test_every_command_of_the_afternoon_does_what_it_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    write_world(tmp_path)
    said = {}
    for lines in packs():
        with standin("--speed", "8", "--rotor", str(tmp_path / "world.toml")) as port:
            with connect(f"udpout:127.0.0.1:{port}") as session:  # this machine may be busy for a moment
                for name, value in (("COM_OF_LOSS_T", 60.0), ("COM_DISARM_PRFLT", -1.0)):
                    Parameters(session).write(name, value, REAL)
            for line in lines:
                words = shlex.split(line.replace(URL, f"udpout:127.0.0.1:{port}"))
                assert words[0] == "coaxlink"
                with pytest.raises(SystemExit) as ended:
                    main(words[1:])
                said[line] = capsys.readouterr()
                assert ended.value.code == 0, f"{line}\n{said[line].err}"
    assert len(said) == 11
    prior, after, two = (
        load_rotor_model(tmp_path / f"{n}.toml") for n in ("rotor", "rotor_flown", "rotor_two")
    )
    u = np.array([0.53])
    true = 55.9517 * u**2 + 22.4464 * u
    true = true + 2.755 * u**4 + 64.721 * u**2 - 2.547 * u**2 + 12.402 * u - 37.502 * u**2 + 0.801
    lifts = [m.loads(u, u).upper_thrust + m.loads(u, u).lower_thrust for m in (prior, after)]
    assert abs(lifts[1] - true) < 0.03 * true  # the weight of the vehicle tells the sum of a pair
    assert abs(lifts[1] - true) < abs(lifts[0] - true)
    assert len(two.identified["flights"]) == 2
    first, second = (out for line, out in said.items() if " fly " in line)
    assert first.out.startswith("flown: identify") and "yaw doublets of" in first.err
    assert second.out.startswith("flown: next.toml")
    told = next(out for line, out in said.items() if "--next" in line)
    assert "the flight that would tell most" in told.err
    judged = next(out for line, out in said.items() if " health " in line)
    # "ground it" has an exit code of its own (above); "watch", at 1 in 20, is what some sound flights get:
    # one of 80 s tells a loss of 5 % from none by a few times the odds only
    assert re.search("^(sound|watch): the probability", judged.out, re.MULTILINE)
