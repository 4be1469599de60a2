"""The tutorial and the how-to pages as a new user follows them, on stand-ins; every command of every page."""

import re
from contextlib import ExitStack

import numpy as np
import pytest
import typer
from pages import DOCS, ROOT, Reader, blocks, typed_lines

from coaxlink.cli import build_app
from coaxlink.fly import commands, flight
from coaxlink.rotor import load_rotor_model

HOW_TO = sorted(f"howto/{p.name}" for p in (DOCS / "howto").glob("*.md"))
FOLLOWED = ("tutorial.md", "stand.md", "airframe.md", *HOW_TO)
PAGES = [ROOT / "README.md", *sorted(p for p in DOCS.rglob("*.md"))]
STAND = DOCS / "stand.md"
MAX_RPM = 5500.0
PATIENCE_S = 300.0  # with a stand-in that a busy machine does not let run


def loads(upper, lower):
    """A pair of this test's own: thrust in N and torque in N m at shares of full speed."""
    above, below = 58.0 * upper**2 + 6.0 * upper, 56.0 * lower**2 + 6.0 * lower
    below = below - 26.0 * upper * lower
    return above, below, 1.35 * upper**2 + 0.2 * upper, 1.3 * lower**2 + 0.2 * lower - 0.25 * upper * lower


def write_stand(path):
    """As the page shows it: semicolons, decimal commas, kgf, N cm."""
    heading = re.search(r"^time \[s\];.*$", STAND.read_text(), re.MULTILINE)
    rng = np.random.default_rng(5)
    rows, t = [heading[0]], 0.0
    for upper in np.linspace(0.2, 0.95, 9):
        for lower in np.linspace(0.2, 0.95, 9):
            above, below, above_q, below_q = loads(upper, lower)
            volts = 25.0 - 0.3 * (upper + lower)
            amps = [
                q * MAX_RPM * u * np.pi / 30 / 0.8 / volts for q, u in ((above_q, upper), (below_q, lower))
            ]
            numbers = [
                t, MAX_RPM * upper, MAX_RPM * lower,
                (above + rng.normal(0, 0.1)) / 9.80665, (below + rng.normal(0, 0.1)) / 9.80665,
                100 * (above_q + rng.normal(0, 0.003)), 100 * (below_q + rng.normal(0, 0.003)), volts, *amps,
            ]  # fmt: skip
            rows.append(";".join(f"{x:.4f}".replace(".", ",") for x in numbers))
            t += 2.0
    path.write_text("\n".join(rows) + "\n")


def figures_are_those_of_the_run(page, reported):
    """The tutorial's numbers, in the two digits that it gives, are what its commands have just printed."""
    page, reported = (" ".join(text.split()) for text in (page, reported))
    errors = r"falls from ([\d.]+) to ([\d.]+) N m"
    printed = re.search(errors + r" \(noise alone: [\d.]+; ([\d.]+) with small corrections", reported)
    given = re.search(errors + r"\..*? down to ([\d.]+) N m", page)
    assert [float(x) for x in given.groups()] == pytest.approx([float(x) for x in printed.groups()], rel=0.05)
    given = re.search(r"rotor 6 had lost (\d+) %", page)
    printed = re.search(r"rotor 6: (\d+) % [^:]* and back since", reported)
    assert abs(int(given[1]) - int(printed[1])) <= 1


@pytest.fixture
def reader(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COAXLINK_STATE", str(tmp_path / "state"))
    monkeypatch.setattr(commands, "SILENCE_S", PATIENCE_S)
    monkeypatch.setattr(flight, "SILENCE_S", PATIENCE_S)
    with ExitStack() as vehicle:
        yield Reader(tmp_path, capsys, vehicle)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_tutorial_then_an_own_stand_and_vehicle_on_px4(reader, tmp_path):
    write_stand(tmp_path / "my_stand.csv")
    reader.follow("tutorial.md")
    reported = "\n".join(out + err for out, err in reader.reported.values())
    assert "found: degraded_rotor" in reported and "verified" in reported
    figures_are_those_of_the_run((DOCS / "tutorial.md").read_text(), reported)
    assert "lower rotors carried" in (tmp_path / "both.html").read_text()

    reader.start("--firmware", "px4", "--airframe", "x8_demo.toml")
    for page in ("stand.md", "airframe.md", "howto/px4.md", "howto/failed_upload.md",
                 "howto/px4_module.md"):  # fmt: skip
        reader.follow(page)
    model = load_rotor_model(tmp_path / "rotor.toml")
    u, v = np.meshgrid(np.linspace(0.3, 1.0, 8), np.linspace(0.3, 1.0, 8))
    scale = model.speed_max_rpm / MAX_RPM
    pair, true = model.loads(u, v), loads(u * scale, v * scale)
    assert np.abs(pair.upper_thrust - true[0]).max() < 0.03 * true[0].max()
    assert np.abs(pair.lower_thrust - true[1]).max() < 0.03 * true[1].max()
    for name in (
        "my_x8.png",
        "my_x8.toml",
        "from_board.toml",
        "tables_px4/vehicle/airframe.toml",
    ):
        assert (tmp_path / name).stat().st_size > 0
    assert "MC_YAWRATE_K" in next((tmp_path / "tables_px4").glob("*.params")).read_text()
    for name in ("stand.html", "flight.html"):
        assert "<html" in (tmp_path / name).read_text()


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_ardupilot_and_the_companion(reader, tmp_path):
    reader.verb("coaxlink examples rotor_paper.toml", 0)
    template = "--template x8 --mass 18.5 --arm 0.3 --spacing 0.16 --rotor rotor_paper.toml"
    reader.verb(f"coaxlink init my_x8.toml {template}", 0)
    reader.follow("howto/ardupilot.md")
    assert (tmp_path / "bridge" / "scripts" / "coaxlink_bridge.lua").is_file()
    reader.follow("howto/raspberry_pi.md")
    assert (tmp_path / "signing.key").stat().st_mode & 0o077 == 0
    reader.follow("howto/replay.md")
    assert "front right" in next(out for line, (out, _) in reader.reported.items() if "--replay" in line)


def test_every_command_to_follow_says_how_it_is_run():
    for page in FOLLOWED:
        for block in blocks(page):
            known = ("run", "not run: ", "second terminal", "third terminal")
            assert block.mark.startswith(known), f"{page}: a block without its mark: {block.lines}"
            if block.mark.startswith("run by "):
                file = ROOT / block.mark.removeprefix("run by ")
                assert file.is_file(), f"{page}: {block.mark}"


def test_every_verb_and_option_on_every_page_exists():
    verbs = typer.main.get_command(build_app()).commands
    options = {
        name: {o for p in verb.params for o in (*p.opts, *p.secondary_opts)} | {"--help"}
        for name, verb in verbs.items()
    }
    checked = 0
    for page in PAGES:
        for line in typed_lines(page.read_text()):
            verb = line.split()[1]
            assert verb in options, f"{page.name}: {line}"
            unknown = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", line)) - options[verb]
            assert not unknown, f"{page.name}: {line}: {unknown}"
            checked += 1
    assert checked > 60


def test_the_service_file_names_what_mix_takes_and_the_exit_codes_that_need_a_person():
    page = (DOCS / "howto" / "raspberry_pi.md").read_text()
    start = re.search(r"^ExecStart=\S+/coaxlink mix (.*)$", page, re.MULTILINE)[1]
    known = {o for p in typer.main.get_command(build_app()).commands["mix"].params for o in p.opts}
    assert set(re.findall(r"--[a-z-]+", start)) <= known
    codes = re.search(r"^RestartPreventExitStatus=(.*)$", page, re.MULTILINE)[1]
    assert codes.split() == ["1", "2", "4", "130"]


@pytest.mark.slow
def test_the_python_on_every_page_runs(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    found = [
        (page, code)
        for page in PAGES
        for code in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    ]
    assert any(page.name == "README.md" for page, _ in found)
    for page, code in found:
        exec(compile(code, str(page), "exec"), {})
    assert capsys.readouterr().out.strip()
