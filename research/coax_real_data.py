"""Every form of rotor model on every coaxial map of the shared real data, into docs/benchmarks.md.

    python research/coax_real_data.py [FOLDER] [--write]

FOLDER defaults to ../shared/data/coax beside the repository. Errors are of coaxial thrust and torque: on
sweeps of the map left out in turn, and on the separate run (`*_run2.csv`) by the model of the whole map.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from coaxlink.data import Samples, read_stand_log
from coaxlink.rotor import identify

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "benchmarks.md"
MARKS = ("<!-- begin: research/coax_real_data.py -->", "<!-- end: research/coax_real_data.py -->")
FORMS = ("srm", "cpcm", "rcrm", "crm", "mutual")
NAMES = {"srm": "SRM", "cpcm": "CPCM", "rcrm": "R-CRM", "crm": "CRM", "mutual": "mutual"}
INTRODUCTION = (
    "## Rotor models on public stand data",
    "",
    "RMSE of the coaxial sum (upper plus lower).",
    "*Sweeps left out*: each sweep of the full-range map predicted by a model that chose its terms without",
    "it, the slowest and the fastest sweep included: those are extrapolated.",
    "*Separate run*: the model of the whole map on another run of the same stand.",
    "*Mutual*: the CRM whose upper rotor may feel the lower one. *Floor*: how neighbouring points scatter.",
    "",
    "Made by `research/coax_real_data.py` from public files that are not redistributed here: the platform",
    "of Buzzatto and Liarokapis (mn4014, propdrive) and pyBEMT (tmotor28).",
)
CONCLUSION = (
    "Over the whole map the R-CRM loses most where one rotor is slow beside a fast one. The separate runs",
    "stay near equal speeds, where squares are nearly enough: there it does as well as the CRM. On the 11 in",
    "pair the CRM is within 1.2 to 1.6 times the scatter of the stand itself, capping the ratio. The 28 in",
    "file holds equal speeds only: it cannot tell the rotors' terms apart.",
)
CHANNELS = {"coaxial_thrust": ("thrust_N", "N"), "coaxial_torque": ("torque_Nm", "N m")}


def maps(folder: Path) -> list[Path]:
    """The coaxial files of which both rotors turn, without the separate runs."""
    found = [p for p in sorted(folder.glob("*.csv")) if not p.stem.endswith("_run2")]
    return [p for p in found if _both_turn(read_stand_log(p))]


def _both_turn(log: Samples) -> bool:
    return log.has("upper_rpm", "lower_rpm") and bool(np.any(log["upper_rpm"]) and np.any(log["lower_rpm"]))


def separate_error(result: object, run: Samples, quantity: str) -> float:
    """RMSE of the coaxial load on rows of another run, by the model of the map."""
    model = result.model  # type: ignore[attr-defined]
    u, v = (run[f"{side}_rpm"] / model.speed_max_rpm for side in ("upper", "lower"))
    loads = model.loads(u, v)
    predicted = {
        "thrust_N": loads.upper_thrust + loads.lower_thrust,
        "torque_Nm": loads.upper_torque + loads.lower_torque,
    }[quantity]
    measured = run[f"upper_{quantity}"] + run[f"lower_{quantity}"]
    return float(np.sqrt(np.mean((measured - predicted) ** 2)))


def rows(path: Path) -> Iterator[tuple[str, str, list[str]]]:
    """(file, channel, cells) of each line of the table."""
    log = read_stand_log(path)
    results = {form: identify(log, form) for form in FORMS}
    other = path.with_name(f"{path.stem}_run2.csv")
    run = read_stand_log(other, upper="left") if other.is_file() else None
    for channel, (quantity, unit) in CHANNELS.items():
        floor = results["crm"].noise_floor[channel]
        held = {form: r.comparison[form][channel].rmse for form, r in results.items()}
        yield path.stem, f"{channel}, {unit}, sweeps left out", _cells(held, floor)
        if run is not None:
            apart = {form: separate_error(r, run, quantity) for form, r in results.items()}
            yield path.stem, f"{channel}, {unit}, separate run", _cells(apart, floor)


def _cells(errors: dict[str, float], floor: float) -> list[str]:
    ratio = errors["rcrm"] / errors["crm"]
    return [*(f"{errors[form]:.4g}" for form in FORMS), f"{floor:.3g}", f"{ratio:.1f}"]


def table(folder: Path) -> str:
    """The section of the page, in Markdown."""
    heads = [NAMES[f] for f in FORMS]
    lines = [
        *INTRODUCTION,
        "",
        f"| file | channel | {' | '.join(heads)} | floor | R-CRM / CRM |",
        f"|---|---|{'---:|' * (len(heads) + 2)}",
    ]
    ratios: dict[tuple[str, str], list[float]] = {}
    for path in maps(folder):
        for name, channel, cells in rows(path):
            lines.append(f"| {name} | {channel} | {' | '.join(cells)} |")
            if channel.startswith("coaxial_thrust"):
                ratios.setdefault((name.split("_")[0], channel.split(", ")[-1]), []).append(float(cells[-1]))
    lines += ["", "R-CRM over CRM in coaxial thrust:"]
    for (pair, where), found in ratios.items():
        if len(found) > 1:
            lines.append(f"- {pair}, {where}: {min(found):.1f} to {max(found):.1f} times")
    lines += ["", *CONCLUSION, ""]
    return "\n".join(lines)


def write(section: str) -> None:
    """Put the section between its marks; the rest of the page stays."""
    block = f"{MARKS[0]}\n{section}{MARKS[1]}\n"
    page = PAGE.read_text(encoding="utf-8") if PAGE.is_file() else "# Benchmarks\n\n"
    if MARKS[0] in page:
        before, rest = page.split(MARKS[0], 1)
        page = before + block + rest.split(f"{MARKS[1]}\n", 1)[1]
    else:
        page = page + block
    PAGE.write_text(page, encoding="utf-8")


def main(arguments: list[str]) -> int:
    """Print the section, or write it into the page."""
    folders = [Path(a) for a in arguments if not a.startswith("--")]
    folder = folders[0] if folders else HERE.parent.parent / "shared" / "data" / "coax"
    if not folder.is_dir():
        print(f"{folder} is not there: name the folder of the stand data", file=sys.stderr)
        return 2
    section = table(folder)
    print(section)
    if "--write" in arguments:
        write(section)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
