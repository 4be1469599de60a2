"""Every verb's command line on spoiled files and with odd options, in the process of `bounded_readers`.

A line ends by itself: nobody answers at NOBODY, and options that would have it go on are left alone.
"""

from __future__ import annotations

import contextlib
import io
import random
import shlex
from collections.abc import Callable
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"
AT_NOBODY = "--connect udpout:127.0.0.1:9 --timeout 0.1"
X8 = f"{EXAMPLES}/x8_demo.toml"
ROTOR = f"{EXAMPLES}/rotor_paper.toml"
LOGS = ("flown CSV", "flight CSV", "ULog", "DataFlash", "tlog", "live record")
ON_LOGS = (
    f"health FILE --airframe {X8} --json o.json",
    f"refine FILE --airframe {X8} --workers 1 --out r.toml",
    f"report FILE --airframe {X8} --out o.html",
    f"monitor --replay FILE --airframe {X8} --once --seconds 0.2 --speed 1000",
)
LINES: tuple[tuple[str, str], ...] = (
    ("airframe", "airframe FILE"),
    ("airframe", "table FILE --firmware px4 --out out"),
    ("airframe", "table FILE --firmware ardupilot --out out"),
    ("airframe", "allocate FILE --law exact --wrench 196,1,1,0.2 --json o.json"),
    ("airframe", "compare FILE --rows 10"),
    ("airframe", "bridge FILE --out out"),
    ("airframe", "mix FILE --connect udpout:127.0.0.1:9 --seconds 0.2 --lost 1"),
    ("airframe", f"motors FILE {AT_NOBODY}"),
    ("rotor model", f"table {X8} --rotor FILE --firmware px4 --law reduced --out out"),
    ("rotor model", f"allocate {X8} --rotor FILE --law exact --wrench 196,1,1,0.2"),
    ("stand CSV", "identify FILE --form rcrm --out r.toml"),
    ("stand CSV", "identify --single FILE --diameter 0.66 --pitch 0.2 --spacing 0.1 --out r.toml"),
    ("stand CSV", "refine FILE --workers 1 --out r.toml"),
    ("stand sheet", "identify FILE --form rcrm --out r.toml"),
    ("column map", "identify STAND --columns FILE --form rcrm --out r.toml"),
    *((kind, line) for kind in LOGS for line in ON_LOGS),
    ("flown CSV", f"identify FILE --airframe {X8} --rotor {ROTOR} --out r.toml"),
    *(
        (kind, "init new.toml --mass 20 --arm 0.4 --spacing 0.1 --from FILE")
        for kind in ("ULog", "DataFlash", ".params table", ".param table", "board for init")
    ),
    ("matrix script", "init new.toml --mass 20 --arm 0.4 --spacing 0.1 --from PARAM --script FILE"),
    *((kind, f"upload FILE --yes {AT_NOBODY}") for kind in (".params table", ".param table")),
    *((kind, f"verify FILE {AT_NOBODY}") for kind in (".params table", ".param table")),
    *((kind, f"restore FILE --yes {AT_NOBODY}") for kind in ("backup PX4", "backup ArduPilot")),
    ("signing key", f"verify PARAM {AT_NOBODY} --signing-key FILE"),
    ("flight plan", f"fly --plan FILE --dry-run {AT_NOBODY}"),
    ("truth", f"sim --airframe {X8} --truth FILE --fly PLAN --log o.csv"),
    ("airframe of the world", "sim --airframe FILE --fly PLAN --log o.csv"),
    ("schedule", "sim --stand o.csv --schedule FILE"),
    ("campaign", "campaign FILE --dry-run --out out"),
)
# these would go on for as long as they say, listen to somebody or work elsewhere
LEFT_ALONE = {
    "--connect", "--help", "--height", "--listen", "--lost", "--memory", "--rows", "--scheduler", "--seconds",
    "--speed", "--timeout", "--web", "--workers",
}  # fmt: skip
# no place outside the scratch folder: an output may be written there
ODD = (
    "", " ", "-1", "0", "-0.0", "nan", "inf", "1e999", "1e-320", "7" * 400, "1,2,3", "1,,2", ",", "a b",
    "\x1b[2J", "é", "\u202e", "x" * 5000, "/dev/null", ".", "no/such/file", "[red]", "{}", "%s", "true",
)  # fmt: skip


def verbs(files: dict[str, Path]) -> dict[str, tuple[str, Callable[[Path], object]]]:
    """{name: (kind of file that is spoiled, the verb on it)}; `files` are sound, by kind.

    InputError where it refused, AssertionError where it fell. "..., odd": its file is sound, and it has one
    or two odd options, drawn by the spoiled file's bytes.
    """
    beside = {"STAND": files["stand CSV"], "PARAM": files[".param table"], "PLAN": files["flight plan"]}
    found: dict[str, tuple[str, Callable[[Path], object]]] = {}
    for number, (kind, line) in enumerate(LINES):
        name = f"{line.split()[0]} {number}: {kind}"

        def spoiled(path: Path, line: str = line) -> None:
            _reported(_words(line, beside | {"FILE": path}))

        def odd(path: Path, line: str = line, kind: str = kind) -> None:
            dice, words = random.Random(path.read_bytes()), _words(line, beside | {"FILE": files[kind]})
            for option, takes_value in dice.sample(_options(words[0]), dice.choice((1, 2))):
                words += [option, dice.choice(ODD)] if takes_value else [option]
            _reported(words)

        found |= {name: (kind, spoiled), f"{name}, odd": (kind, odd)}
    return found


def _words(line: str, places: dict[str, Path]) -> list[str]:
    return [str(places.get(word, word)) for word in shlex.split(line)]


def _options(verb: str) -> list[tuple[str, bool]]:
    import typer

    from coaxlink.cli import build_app

    found = typer.main.get_command(build_app()).commands[verb].params  # type: ignore[attr-defined]
    return [
        (p.opts[0], not getattr(p, "is_flag", False))
        for p in found
        if p.opts[0].startswith("--") and not LEFT_ALONE & set(p.opts)
    ]


def _reported(words: list[str]) -> None:
    from coaxlink.cli import main
    from coaxlink.errors import InputError

    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main(words)
    except SystemExit as ended:
        code = ended.code
    reported = err.getvalue().strip()
    last = reported.splitlines()[-1] if reported else ""
    if "MemoryError" in reported:
        raise MemoryError(last)
    if code == 2 and "Traceback" not in reported:
        raise InputError("coaxlink", "", last.removeprefix("coaxlink: "))
    assert code in (0, 1, 3, 4) and "Traceback" not in reported, f"{code} {last} {words}"
