"""`coaxlink fly --plan split`: the plan's part before, in and after the flight that `fly` flies."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink.cli.shared.shell import console, say
from coaxlink.errors import InputError

if TYPE_CHECKING:
    from coaxlink.fly.split_answer import Dwells, SplitAnswer
    from coaxlink.fly.split_flight import SplitFlight
    from coaxlink.fly.trajectory import FlightPlan
    from coaxlink.mavlink import Session
    from coaxlink.vehicle import Vehicle

PLAN = "split"
LEVELS = 7  # splits that are flown, evenly over the reach


class Split:
    """One flight of the plan."""

    def __init__(
        self,
        vehicle: Vehicle | None,
        airframe: Path | None,
        minutes: float,
        reach: float,
        after: list[Path],
    ) -> None:
        """`after` are the JSON of flights before. Raises InputError: no vehicle, too short, no such JSON."""
        from coaxlink.fly.split_plan import DWELL_S

        if vehicle is None or airframe is None:
            raise InputError("--plan", PLAN, "the vehicle is expected with --airframe")
        if not vehicle.airframe.pairs:
            raise InputError(airframe, "rotors", "no pair of an upper and a lower rotor, so no split")
        self._vehicle, self._airframe, self._reach = vehicle, airframe, reach
        self._dwells = int(60.0 * minutes / DWELL_S)
        if self._dwells < 2 * LEVELS:
            least = 2 * LEVELS * DWELL_S / 60.0
            raise InputError("--minutes", f"{minutes:g}", f"{least:.1f} at least: each split twice")
        self._flight: SplitFlight | None = None
        self._earlier = tuple(_dwells_in(path) for path in after)

    def hover(self, height_m: float) -> FlightPlan:
        """What the vehicle itself is asked to fly."""
        from coaxlink.fly.split_plan import SplitPlan

        return SplitPlan((), 0.0, self._dwells).flight(height_m)

    def prepare(self, session: Session) -> None:
        """Look at the board and say what will be done. Raises SafetyRefusal, InputError."""
        from coaxlink.fly.split_flight import SplitFlight

        flight = SplitFlight(session, self._vehicle, reach=self._reach, levels=LEVELS, dwells=self._dwells)
        flight.record.earlier = self._earlier
        say(flight.plan.words())
        say("at its end, a limit or your mode change the companion is silent: the split on board flies again")
        self._flight = flight

    def mixing(self) -> AbstractContextManager[None]:
        """For the plan alone."""
        assert self._flight is not None
        return self._flight.mixing()

    def watch(self, t: float) -> None:
        """Move the split."""
        assert self._flight is not None
        self._flight.watch(t)

    def answer(self) -> SplitAnswer:
        """Of what was flown. Raises InputError where that is too little."""
        assert self._flight is not None
        return self._flight.record.answer()

    def as_json(self) -> dict[str, Any]:
        """The answer, or why there is none."""
        if self._flight is None:
            return {}
        readings: dict[str, Any] = {"source": "BATTERY_STATUS", "readings": len(self._flight.record.rows)}
        try:
            readings["dwell_rows"] = self._flight.record.dwells().as_json()
            return {"split": {**self.answer().as_json(), **readings}}
        except InputError as error:
            return {"split": {"why": str(error), **readings}}

    def tell(self, out: Path) -> None:
        """The answer, its picture, and what to do next. Raises CheckFailed where there is none."""
        from coaxlink.errors import CheckFailed
        from coaxlink.report.pictures.figures import write_figure
        from coaxlink.report.split import split_figure

        try:
            answer = self.answer()
        except InputError as error:
            raise CheckFailed(f"flown, but the split is not answered: {error}") from error
        console().print(answer.words(), soft_wrap=True)
        say(
            "it rests on BATTERY_STATUS: a current sensor scaled wrong changes the watts, not the share "
            "or the per cent"
        )
        picture = out / "split.png"
        write_figure(picture, split_figure(answer))
        say(f"wrote {picture}")
        if answer.worth_it:
            say(
                f"next: coaxlink table {self._airframe} --firmware px4|ardupilot --share {answer.share:.3f} "
                "--out tables"
            )
            say("then: coaxlink upload tables --connect URL")
        else:
            say("next: nothing to upload, the split on board may stay")


def _dwells_in(path: Path) -> Dwells:
    from coaxlink import files
    from coaxlink.fly.split_answer import Dwells
    from coaxlink.fly.split_plan import COLUMNS

    try:
        return Dwells.of_json(files.read_json(path)["split"]["dwell_rows"], len(COLUMNS))
    except (KeyError, TypeError, ValueError) as error:
        problem = f"what `fly --plan split --json` wrote is expected ({error})"
        raise InputError(path, "split.dwell_rows", problem) from error
