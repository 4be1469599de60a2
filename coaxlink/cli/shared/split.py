"""`coaxlink fly --plan split`: the plan's part before, in and after the flight that `fly` flies."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coaxlink.cli.shared.shell import console, say
from coaxlink.errors import InputError, SafetyRefusal

if TYPE_CHECKING:
    from coaxlink.fly.split_answer import Dwells, SplitAnswer
    from coaxlink.fly.split_flight import SplitFlight
    from coaxlink.fly.table_flights import TableFlight, TablesAnswer
    from coaxlink.fly.trajectory import FlightPlan
    from coaxlink.mavlink import Session
    from coaxlink.vehicle import Vehicle

PLAN = "split"
LEVELS = 7  # splits that are flown, evenly over the reach
TABLE_DWELLS = 5  # of a hover with one table: 90 s


class Split:
    """One flight of the plan."""

    def __init__(
        self,
        vehicle: Vehicle | None,
        airframe: Path | None,
        minutes: float,
        reach: float,
        after: list[Path],
        tables: bool,
    ) -> None:
        """`after` are the JSON of flights before; with `tables` a flight is one hover with that on board.

        Raises InputError: no vehicle, too short, no such JSON.
        """
        from coaxlink.fly.split_plan import DWELL_S

        if vehicle is None or airframe is None:
            raise InputError("--plan", PLAN, "the vehicle is expected with --airframe")
        if not vehicle.airframe.pairs:
            raise InputError(airframe, "rotors", "no pair of an upper and a lower rotor, so no split")
        self._vehicle, self._airframe, self._reach = vehicle, airframe, reach
        self._dwells = int(60.0 * minutes / DWELL_S)
        least, why = (
            (TABLE_DWELLS, "a hover is judged by them") if tables else (2 * LEVELS, "each split twice")
        )
        if self._dwells < least:
            raise InputError("--minutes", f"{minutes:g}", f"{least * DWELL_S / 60.0:.1f} at least: {why}")
        self._flight: SplitFlight | TableFlight | None = None
        self._after, self._earlier = tuple(after), tuple(_dwells_in(path) for path in after)
        self._tables = tables

    def hover(self, height_m: float) -> FlightPlan:
        """What the vehicle itself is asked to fly."""
        from coaxlink.fly.split_plan import SplitPlan

        return SplitPlan((), 0.0, self._dwells).flight(height_m)

    def prepare(self, session: Session) -> None:
        """Look at the board and say what will be done. Raises SafetyRefusal, InputError."""
        from coaxlink.fly.split_flight import SplitFlight

        if self._tables:
            self._prepare_table(session)
            return
        try:
            flight = SplitFlight(
                session, self._vehicle, reach=self._reach, levels=LEVELS, dwells=self._dwells
            )
        except SafetyRefusal as error:
            raise SafetyRefusal(f"{error.reason}; or two tables in turn, with --tables") from error
        flight.record.earlier = self._earlier
        say(flight.plan.words())
        if flight.trial:
            from coaxlink.fly.split_trial import ON_BOARD, TRIAL

            say(
                f"by the module's {TRIAL}: at its end, a limit, your mode change or without this program the "
                f"share on board ({ON_BOARD}) flies again"
            )
        else:
            say("at its end, a limit or your mode change the companion is silent: the split on board is back")
        self._flight = flight

    def _prepare_table(self, session: Session) -> None:
        from coaxlink.fly.table_flights import SCATTER, SEEN, TableFlight, flights_for

        self._flight = TableFlight(session, self._vehicle, dwells=self._dwells)
        say(
            f"tables: hovers {self._flight.plan.duration_s / 60:.1f} minutes with the table on board, "
            f"{self._flight.share:.3f} of the thrust from above; flight {len(self._earlier) + 1}"
        )
        say(
            f"{flights_for(SEEN, SCATTER)} flights of each table tell {100 * SEEN:.0f} %, if two hovers with "
            f"one table are within {100 * SCATTER:.0f} % of one another; in the order A B B A, fresh packs"
        )

    def mixing(self) -> AbstractContextManager[None]:
        """For the plan alone."""
        assert self._flight is not None
        return self._flight.mixing()

    def watch(self, t: float) -> None:
        """Move the split."""
        assert self._flight is not None
        self._flight.watch(t)

    def answer(self) -> SplitAnswer | TablesAnswer:
        """Of what was flown. Raises InputError where that is too little."""
        from coaxlink.fly.table_flights import compare_tables

        assert self._flight is not None
        record = self._flight.record
        return compare_tables([*self._earlier, record.dwells()]) if self._tables else record.answer()

    def as_json(self) -> dict[str, Any]:
        """The answer, or why there is none."""
        if self._flight is None:
            return {}
        readings: dict[str, Any] = {"source": "BATTERY_STATUS", "readings": len(self._flight.record.rows)}
        try:
            readings["escs"] = self._flight.record.escs().as_json()
        except InputError as error:
            readings["escs"] = {"why": str(error)}
        try:
            readings["dwell_rows"] = self._flight.record.dwells().as_json()
            return {"split": {**self.answer().as_json(), **readings}}
        except InputError as error:
            return {"split": {"why": str(error), **readings}}

    def tell(self, out: Path) -> None:
        """The answer, its picture, and what to do next. Raises CheckFailed where there is none."""
        from coaxlink.errors import CheckFailed
        from coaxlink.fly.split_flight import SplitFlight
        from coaxlink.fly.table_flights import TablesAnswer
        from coaxlink.report.pictures.figures import write_figure
        from coaxlink.report.split import split_figure

        if self._tables and not self._two_of_each():
            self._tell_escs()
            self._tell_next_table()
            return
        try:
            answer = self.answer()
        except InputError as error:
            raise CheckFailed(f"flown, but the split is not answered: {error}") from error
        if isinstance(answer, TablesAnswer):
            self._tell_tables(answer)
            return
        assert isinstance(self._flight, SplitFlight)
        console().print(answer.words(), soft_wrap=True)
        say(
            "it rests on BATTERY_STATUS: a current sensor scaled wrong changes the watts, not the share "
            "or the per cent"
        )
        self._tell_escs()
        picture = out / "split.png"
        write_figure(picture, split_figure(answer))
        say(f"wrote {picture}")
        if not answer.worth_it:
            say("next: nothing to upload, the split on board may stay")
            return
        if self._flight.trial:
            from coaxlink.fly.split_trial import ON_BOARD

            say(f"next: on the ground, {ON_BOARD} {answer.share:.3f} in the ground station's parameters")
            if answer.at_edge:
                say("then this plan once more: it begins there")
            return
        self._say_table(answer.share)
        if self._flight.by_module:
            say(
                "the module on board flies a law of its own: coaxlink bridge --connect URL --back comes first"
            )
        elif answer.at_edge:
            say("then this plan once more, with that table on board: it begins at its split")

    def tell_cut_short(self, kept: Path | None) -> None:
        """What a flight that ended early is good for; `kept` is where its JSON goes."""
        from coaxlink.fly.table_flights import TablesAnswer

        assert self._flight is not None
        try:
            self._flight.record.dwells()
        except InputError:
            return  # nothing was measured
        try:
            answer = self.answer()
            if not isinstance(answer, TablesAnswer):
                console().print(f"up to its end: {answer.words()}", soft_wrap=True)
        except InputError as error:
            say(f"up to its end the split is not answered: {error}")
        flights = "".join(f" --after {path}" for path in (*self._after, kept))
        how = f"again with{flights}" if kept else "again; --json FILE keeps a flight for --after"
        say(f"what was flown counts: a fresh pack, and this plan {how}")

    def _tell_escs(self) -> None:
        """The other measurement of the same current, or why there is none."""
        assert self._flight is not None
        try:
            for line in self._flight.record.escs().words():
                say(line)
        except InputError as error:
            say(f"not held against the ESCs' amps: {error}")

    def _say_table(self, share: float) -> None:
        say(
            f"next: coaxlink table {self._airframe} --firmware px4|ardupilot --share {share:.3f} --out tables"
        )
        say("then: coaxlink upload tables --connect URL")

    def _flown(self) -> list[Dwells]:
        assert self._flight is not None
        return [*self._earlier, self._flight.record.dwells()]

    def _two_of_each(self) -> bool:
        from coaxlink.fly.table_flights import counted

        return min(counted(self._flown())) >= 2

    def _tell_next_table(self) -> None:
        """After one of the first flights."""
        from coaxlink.fly.table_flights import counted

        first, second = counted(self._flown())
        console().print(
            f"flights so far: {first} with the first table, {second} with another; two of each answer"
        )
        if not second:
            say(f"next: coaxlink table {self._airframe} --firmware px4|ardupilot --law fitted --out tables")
            say("then: coaxlink upload tables --connect URL, a fresh pack, and again, this flight in --after")
        else:
            say("next: the other table or this one, so that the order is A B B A; all flights in --after")

    def _tell_tables(self, answer: TablesAnswer) -> None:
        from coaxlink.fly.table_flights import SEEN, flights_for

        console().print(answer.words(), soft_wrap=True)
        self._tell_escs()
        need, flown = flights_for(SEEN, answer.scatter), answer.flights
        say(
            f"two hovers with one table are within {100 * answer.scatter:.1f} % of one another: {need} "
            f"flights of each tell {100 * SEEN:.0f} %, flown {flown[0]} and {flown[1]}"
        )
        if answer.worth_it:
            say(f"next: the table with {answer.better:.3f} of the thrust from above stays on board")


def _dwells_in(path: Path) -> Dwells:
    from coaxlink import files
    from coaxlink.fly.split_answer import Dwells
    from coaxlink.fly.split_plan import COLUMNS

    try:
        return Dwells.of_json(files.read_json(path)["split"]["dwell_rows"], len(COLUMNS))
    except (KeyError, TypeError, ValueError) as error:
        problem = f"what `fly --plan split --json` wrote is expected ({error})"
        raise InputError(path, "split.dwell_rows", problem) from error
