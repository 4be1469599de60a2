"""Every reader and verb on spoiled files, in a child with 1 GB of its own and 30 s a file."""

from __future__ import annotations

import lzma
import multiprocessing
import os
import resource
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace

HERE = Path(__file__).parent
GB, SECONDS = 1 << 30, 30  # of the processor: how busy the machine is elsewhere is no fault of a file
WAIT_S = 20 * SECONDS  # of the clock, for what waits without working
Case = tuple[str, int]  # kind and number: a file is spoiled the same way always


@dataclass(frozen=True)
class Outcome:
    """What came of one file: ok, refused, traceback, hang, memory or killed; `text` is the error's."""

    kind: str
    number: int
    result: str
    text: str = ""
    seconds: float = 0.0
    peak_MB: float = 0.0  # above what the process had before the file


def readers() -> dict[str, Callable[[Path], object]]:
    """What each kind of file goes through before coaxlink acts on it."""
    from sound_files import PX4, stand_rows

    from coaxlink.cli.shared.board_source import layout_of_file
    from coaxlink.cli.shared.effects import vehicle_of
    from coaxlink.data import is_flight_log, read_flight_log, read_stand_log
    from coaxlink.data.logs.live_record import read_record
    from coaxlink.mavlink.signing import Signer, load_key
    from coaxlink.rotor import load_rotor_model, save_rotor_model
    from coaxlink.studies.campaign.flights import known_effects
    from coaxlink.studies.campaign.spec import read_spec
    from coaxlink.tables.px4 import report_px4
    from coaxlink.uploading.backup import read_backup
    from coaxlink.uploading.journal import Journal
    from coaxlink.uploading.limits import board_limits
    from coaxlink.uploading.plan import load_plan, refuse_values
    from firmware_params import px4
    from firmware_params.ardupilot import packed
    from firmware_params.ardupilot.scripts import script_factors
    from sim.line.memory import Memory
    from sim.manoeuvres import read_plan
    from sim.physics.rotors import read_pair
    from sim.px4.autopilot import Autopilot
    from sim.simulation import Simulation, build_plant
    from sim.stand.effects import read_bench
    from sim.stand.schedule import read_schedule
    from sim.truth import read_truth, truth_text
    from sim.vehicle import read_vehicle

    def rotor(path: Path) -> None:
        model = load_rotor_model(path)
        model.loads(0.5, 0.5)
        save_rotor_model(path.with_name("again.toml"), model)
        assert load_rotor_model(path.with_name("again.toml")).terms() == model.terms()

    def log(path: Path) -> object:
        return (read_flight_log if is_flight_log(path) else read_stand_log)(path)

    def column_map(path: Path) -> None:
        path.with_name("s.csv").write_text(stand_rows())
        read_stand_log(path.with_name("s.csv"), path)

    def plan(path: Path) -> None:
        found = load_plan(path)
        refuse_values(found.firmware, found.params, path)
        if found.firmware == "px4":
            px4.realise(found.params)

    def journal(path: Path) -> None:
        own = Journal(PX4, path.parent)
        (own.open_entry if path == own.path else own.last)()

    def signing_state(path: Path) -> None:
        state_folder = path.with_name("state")
        first = Signer(bytes(32), state_folder)
        first.tick()
        first.close()
        (file,) = state_folder.glob("*.json")
        shutil.copy(path, file)
        Signer(bytes(32), state_folder).close()

    def signing_key(path: Path) -> None:
        path.chmod(0o600)
        load_key(path)

    def limits(path: Path) -> None:
        board = SimpleNamespace(read=lambda _: lzma.compress(path.read_bytes()))
        board_limits(board, replace(PX4, capabilities=32, git_hash="0" * 16))

    def memory(path: Path) -> None:
        plant, truth = build_plant(Simulation(HERE.parents[1] / "examples" / "x8_demo.toml"))
        Memory(path, Autopilot(plant, truth, version=(1, 16, 1), seed=0), lazy=True).load()

    return {
        "airframe": lambda path: report_px4(vehicle_of(path, None)[0], "standard"),
        "airframe of the world": read_vehicle,
        "rotor model": rotor,
        "rotor of the world": read_pair,
        **dict.fromkeys(
            ("stand CSV", "stand sheet", "flight CSV", "flown CSV", "ULog", "DataFlash", "tlog"), log
        ),
        "column map": column_map,
        ".params table": plan,
        ".param table": plan,
        "matrix script": lambda path: script_factors(path.read_bytes().decode("utf-8", "replace")),
        "packed parameters": lambda path: packed.unpack(path.read_bytes()),
        "board for init": layout_of_file,
        "backup PX4": read_backup,
        "backup ArduPilot": read_backup,
        "journal": journal,
        "verified record": journal,
        "signing state": signing_state,
        "signing key": signing_key,
        "board's limits": limits,
        "live record": read_record,
        "truth": lambda path: truth_text(read_truth(path)),
        "truth of a stand": read_bench,
        "schedule": read_schedule,
        "flight plan": lambda path: read_plan(path)[0](1.0),
        "rotor of blades": read_pair,
        "world's memory": memory,
        "campaign": lambda path: read_spec(path, known_effects()),
    }


def run(cases: list[Case], folder: Path) -> Iterator[Outcome]:
    """What comes of each case. `folder` holds the sound files, by kind."""
    left = list(cases)
    names = list(dict.fromkeys(name for name, _ in cases))
    processes = multiprocessing.get_context("spawn")
    while left:
        line, childs = processes.Pipe()
        child = processes.Process(target=_serve, args=(folder, names, childs), daemon=True)
        child.start()
        childs.close()
        line.recv()  # it is ready, or this raises EOFError
        while left:
            case = left.pop(0)
            try:
                line.send(case)
                answered = line.poll(WAIT_S)
                yield line.recv() if answered else Outcome(*case, "hang")
            except (EOFError, ConnectionError):
                child.join()
                yield Outcome(*case, "killed", f"exit code {child.exitcode}")
                answered = False
            if not answered:
                break
        child.kill()
        child.join()


class Late(BaseException):
    """The file took longer than it may; no reader catches this."""


def _late(*_: object) -> None:
    raise Late


def _megabytes(field: str) -> float:
    status = Path("/proc/self/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith(field)).split()[1]) / 1024


def _one(read: Callable[[Path], object], path: Path) -> tuple[str, str]:
    from coaxlink.errors import CoaxlinkError
    from firmware_params.errors import FirmwareParamsError
    from sim.errors import SimError

    try:
        read(path)
        return "ok", ""
    except (CoaxlinkError, FirmwareParamsError, SimError) as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, MemoryError):
                return "memory", str(error)
            cause = cause.__cause__
        text = str(error)
        return ("refused", text) if text.isprintable() and 0 < len(text) < 1200 else ("traceback", repr(text))
    except MemoryError:
        return "memory", "MemoryError"
    except Late:
        return "hang", ""
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return (
            "traceback",
            f"{type(error).__name__}: {str(error)[:150]} ({Path(last.filename).name}:{last.lineno})",
        )


def _serve(folder: Path, names: list[str], line: Connection) -> None:
    """The child: cases come in, outcomes go out."""
    from bounded_verbs import verbs
    from damage import damaged
    from sound_files import MAKERS, file_of

    warnings.simplefilter("ignore")
    os.dup2(2, 1)  # what a library prints is no answer
    files = {kind: file_of(folder, kind) for kind in MAKERS}
    of_verbs = verbs(files)
    table = {kind: (kind, read) for kind, read in readers().items()} | of_verbs
    contents = {kind: path.read_bytes() for kind, path in files.items()}
    with tempfile.TemporaryDirectory() as scratch:  # imports, compiled code: not the first file's doing
        os.environ["COAXLINK_STATE"] = f"{scratch}/state"
        first = {name.split()[0] if name in of_verbs else name: name for name in reversed(names)}
        for name in first.values():
            kind, read = table[name]
            path = files[kind]
            work = Path(shutil.copytree(path.parent, Path(scratch) / name.replace(" ", "-"))) / path.name
            os.chdir(work.parent)
            result = _one(read, work)  # a verb may ask more of a file than a reader
            assert result[0] == "ok" or (name in of_verbs and result[0] == "refused"), (name, result)
    resource.setrlimit(resource.RLIMIT_AS, (int(_megabytes("VmSize") * 2**20) + GB,) * 2)
    signal.signal(signal.SIGPROF, _late)
    line.send("ready")
    while True:
        name, number = line.recv()
        kind, read = table[name]
        with tempfile.TemporaryDirectory() as scratch:
            work = Path(shutil.copytree(files[kind].parent, Path(scratch) / "w")) / files[kind].name
            work.write_bytes(damaged(contents[kind], f"{name}/{number}", list(contents.values())))
            os.chdir(work.parent)
            Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
            before, start = _megabytes("VmRSS"), time.process_time()
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            try:
                result, text = _one(read, work)
            except Late:  # it came while the error was told
                result, text = "hang", ""
            signal.setitimer(signal.ITIMER_PROF, 0)
            seconds, peak = time.process_time() - start, max(_megabytes("VmHWM") - before, 0.0)
            line.send(Outcome(name, number, result, text.replace(scratch, ""), seconds, peak))
