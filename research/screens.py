"""Pictures of the monitor (SVG) from a live run: a simulated PX4 takes off with the paper's X8 and hovers.

python research/screens.py FOLDER
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from coaxlink import files
from coaxlink.fly.commands import Commander as Autopilot
from coaxlink.mavlink import connect
from coaxlink.monitor.feed import Feed
from coaxlink.monitor.screen.app import Monitor
from coaxlink.monitor.watch import Watch
from coaxlink.vehicle import load_vehicle
from sim.testing import standin

X8 = files.example("x8_paper.toml")
SIZES = {"small": (80, 24), "large": (200, 60)}


def take_off(address: str) -> None:
    """Arm and climb to 3 m."""
    with connect(address) as session:
        autopilot = Autopilot(session)
        autopilot.arm()
        autopilot.take_off(3.0)


async def pictures(address: str, folder: Path) -> None:
    """Every page small, the first one large and in every theme too."""
    watch = Watch(address, load_vehicle(X8))
    feed = Feed(watch)
    feed.start()
    try:
        app = Monitor(watch.look, trouble=lambda: feed.failure)
        async with app.run_test(size=SIZES["small"]) as pilot:
            await asyncio.to_thread(take_off, address)
            await asyncio.sleep(15.0)

            async def keep(name: str) -> None:
                await pilot.pause(0.5)
                files.write_atomic(folder / f"monitor-{name}.svg", app.export_screenshot(title=app.TITLE))
                print(folder / f"monitor-{name}.svg")

            for page in ("split", "error", "parameters", "messages", "health"):
                app.action_page(page)
                await keep(page)
            app.action_page("split")
            for theme in ("light", "none", "dark"):
                app.use_palette(theme)
                await keep(theme)
            await pilot.press("question_mark")
            await keep("help")
            await pilot.press("escape")
            await pilot.resize_terminal(*SIZES["large"])
            await keep("large")
    finally:
        feed.stop()


def main() -> None:
    """Write them."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "screens")
    with standin("--firmware", "px4", "--airframe", str(X8)) as port:
        asyncio.run(pictures(f"udpout:127.0.0.1:{port}", folder))


if __name__ == "__main__":
    main()
