"""The PX4 stand-in as the research fork that reads `mixer.csv`: one parameter more, on a free port."""

import threading
from contextlib import contextmanager
from pathlib import Path

from sim.standin import run
from sim.world import World, build_many

EXAMPLES = Path(__file__).parents[2] / "examples"
BOARD_PATH = "etc/mixer.csv"  # below /fs/microsd


@contextmanager
def fork_board(switch="DTRG_MIXER_CSV"):
    """Yields (address, the stand-in's files, its parameter store)."""
    (standin,) = build_many(World(EXAMPLES / "x8_paper.toml"), 1, ["udpin:127.0.0.1:0"], 1.0)
    store = standin.autopilot.store
    store._add(switch, 6, 0)
    store.names = sorted(store._values)
    stopping = threading.Event()
    thread = threading.Thread(target=run, args=([standin], 1.0, stopping.is_set), daemon=True)
    thread.start()
    port = standin.ports[0].name.rpartition(":")[2]
    try:
        yield f"udpout:127.0.0.1:{port}", standin.autopilot.files, store
    finally:
        stopping.set()
        thread.join(5)
        standin.ports[0].close()
