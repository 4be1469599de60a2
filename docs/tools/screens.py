"""Pictures of the monitor's pages (SVG) from a live run: a simulated PX4 takes off with the paper's X8.

python docs/tools/screens.py FOLDER       (--small: a hover of 2 s, pictures made and thrown away)
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from coaxlink import files
from coaxlink.fly.commands import Commander as Autopilot
from coaxlink.mavlink import connect
from coaxlink.monitor.incoming.heard import Heard
from coaxlink.monitor.incoming.link import LinkThread
from coaxlink.monitor.screen.app import Monitor
from coaxlink.monitor.state.watch import Watch
from coaxlink.vehicle import load_vehicle
from sim.testing import standin

X8 = files.example("x8_paper.toml")


def take_off(address: str) -> None:
    """Arm and climb to 3 m."""
    with connect(address) as session:
        autopilot = Autopilot(session)
        autopilot.arm()
        autopilot.take_off(3.0)


async def pictures(address: str, folder: Path, hover_s: float) -> None:
    """Every page at 80x24, the first one large too."""
    watch = Watch(Heard(), load_vehicle(X8), address)
    link = LinkThread(watch.heard, address)
    link.start()
    app = Monitor(watch.look, trouble=lambda: link.failure)
    try:
        async with app.run_test(size=(80, 24)) as pilot:
            await asyncio.to_thread(take_off, address)
            await asyncio.sleep(hover_s)
            for name in ("split", "error", "parameters", "messages", "health", "large"):
                if name == "large":
                    await pilot.resize_terminal(160, 48)
                app.action_page("split" if name == "large" else name)
                await pilot.pause(0.5)
                path = folder / f"monitor-{name}.svg"
                files.write_atomic(path, app.export_screenshot(title=app.TITLE))
                sys.stdout.write(f"{path}\n")
    finally:
        link.stop()


def main() -> None:
    """Write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=Path("screens"))
    parser.add_argument("--small", action="store_true", help="what CI runs")
    given = parser.parse_args()
    with standin("--firmware", "px4", "--airframe", str(X8)) as port, TemporaryDirectory() as scratch:
        folder = Path(scratch) if given.small else given.folder
        asyncio.run(pictures(f"udpout:127.0.0.1:{port}", folder, 2.0 if given.small else 15.0))


if __name__ == "__main__":
    main()
