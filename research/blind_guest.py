"""The guest's half of `blind.py`: a log and the files that a user would have, and what coaxlink says of them.

    PYTHONPATH=../old python research/blind_guest.py FOLDER old

answers the worlds that `blind.py --folder FOLDER` made by whatever coaxlink is imported. No world is imported
here: another checkout has another one.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")


def analyse(task: dict[str, str | None], logs: Path) -> dict[str, object]:
    """What is said of a log, and the seconds of processor that it took."""
    from coaxlink import files
    from coaxlink.airframe import load_airframe
    from coaxlink.data import read_flight_log, read_stand_log
    from coaxlink.residual import refine, refine_stand
    from coaxlink.rotor import load_rotor_model

    log = logs / str(task["log"])
    model = load_rotor_model(files.example(task["rotor"])) if task["rotor"] else None
    start = time.process_time()  # wall time would count who else uses the machine
    if task["kind"] == "stand":
        answer = refine_stand(read_stand_log(log), model)
    else:
        text = logs / str(task["airframe"])
        beside = logs / "rotor_paper.toml"
        if not beside.exists():
            beside.write_text(files.example("rotor_paper.toml").read_text())
        assert model is not None
        answer = refine(read_flight_log(log), load_airframe(text), model)
    out = answer.to_json()
    out.pop("trace", None)
    return {**out, "seconds": time.process_time() - start}


def main() -> None:
    """Answers of whatever coaxlink is imported (PYTHONPATH) to worlds that are there: FOLDER NAME."""
    folder, answers = Path(sys.argv[1]), Path(sys.argv[1]) / f"answers-{sys.argv[2]}"
    answers.mkdir(exist_ok=True)
    for task in sorted((folder / "logs").glob("*.task.json")):
        kept = answers / task.name.replace(".task", "")
        if not kept.exists():
            try:
                answer = analyse(json.loads(task.read_text()), task.parent)
            except Exception:
                answer = {"failed": traceback.format_exc(limit=4)}
            kept.write_text(json.dumps(answer))


if __name__ == "__main__":
    main()
