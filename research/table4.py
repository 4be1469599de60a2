"""The paper's Table 4, flown: hover at 3 m and the circle of 2 m around 4.5 m, a row a mixer.

Run: python research/table4.py. The first rows are the paper's own figures.
"""

from __future__ import annotations

from pathlib import Path

from coaxlink.airframe import load_airframe
from coaxlink.mixer import make_law
from coaxlink.rotor import load_rotor_model
from coaxlink.vehicle import Vehicle
from sim.geometric import ROWS, fly_law
from sim.world import World, build_plant

EXAMPLES = Path(__file__).parents[1] / "examples"
PAPER = {
    "coaxial": (0.3653, 0.3662, 0.0698, 0.10785, 0.08570, 0.4667, 0.58),
    "standard": (0.3656, 0.3661, 0.6373, 0.10451, 0.08423, 0.00105, 4.78),
    "reduced": (0.3652, 0.3659, 0.3335, 0.10624, 0.0850, 0.00108, 2.75),
}
LAWS = (
    ("standard-printed", "rotor_srm_paper.toml"),
    ("standard", "rotor_paper.toml"),
    ("reduced", "rotor_rcrm_paper.toml"),
    ("reduced", "rotor_paper.toml"),
    ("coaxial-printed", "rotor_paper.toml"),
    ("coaxial", "rotor_paper.toml"),
    ("fitted", "rotor_paper.toml"),
    ("exact", "rotor_paper.toml"),
)


def main() -> None:
    """Print the table."""
    airframe = load_airframe(EXAMPLES / "x8_demo.toml")
    print(f"{'':38s}" + "".join(f"{name:>11s}" for name in ROWS))
    for name, row in PAPER.items():
        print(f"{'paper: ' + name:38s}" + "".join(f"{value:11.4f}" for value in row))
    for law, rotor in LAWS:
        plant, _ = build_plant(World(EXAMPLES / "x8_demo.toml"))
        errors = fly_law(plant, make_law(law, Vehicle(airframe, load_rotor_model(EXAMPLES / rotor))).speeds)
        print(f"{law + ' on ' + rotor:38s}" + "".join(f"{errors[name]:11.4f}" for name in ROWS), flush=True)


if __name__ == "__main__":
    main()
