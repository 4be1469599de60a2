"""The stand-in's mixer: from its own parameters, as the firmware computes it, rebuilt when they change."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from firmware_params.errors import TableError
from firmware_params.px4 import Px4Mix, Px4Table, params_to_table, realise
from sim.px4.store import Px4Store

NAMES = ("CA_", "THR_MDL_FAC", "MC_AIRMODE", "SYS_CTRL_ALLOC")
FIELDS = ("CT", "KM", "AX", "AY", "AZ", "PX", "PY", "PZ")


class Px4Mixer:
    """Normalised torque and thrust to motor commands; a table it cannot mix stops the motors."""

    def __init__(self, store: Px4Store, rotors: int) -> None:
        self._store, self._rotors = store, rotors
        self._boot = store.values()
        self._mix: Px4Mix | None = None
        self._stale = True
        store.listen(self._heard)

    def _heard(self, name: str) -> None:
        # an upload writes dozens of parameters: rebuild once, when next asked
        self._stale = self._stale or name.startswith(NAMES)

    @property
    def legacy(self) -> bool:
        """Whether the mixer is the old geometry one, which knows no table (v1.13, SYS_CTRL_ALLOC = 0)."""
        return "SYS_CTRL_ALLOC" in self._store and self._store["SYS_CTRL_ALLOC"] == 0

    @property
    def mix(self) -> Px4Mix | None:
        """What the firmware makes of the present parameters; None when it can make nothing of them."""
        if self._stale:
            try:
                with np.errstate(all="ignore"):  # rotors a light-year out are no reason to stop
                    made = realise(self._table())
                self._mix = made if np.isfinite(made.mix).all() else None
            except (TableError, ArithmeticError, ValueError):
                self._mix = None
            self._stale = False
        return self._mix

    def _table(self) -> Px4Table:
        if not self.legacy:
            return params_to_table(self._store.values())
        # the geometry mixer was compiled in with the airframe: equal rotors, whatever CA_* say
        table = params_to_table(self._boot)
        rotors = tuple(dataclasses.replace(r, ct=6.5, km=0.05 * np.sign(r.km)) for r in table.rotors)
        factor, airmode = float(self._store["THR_MDL_FAC"]), int(self._store["MC_AIRMODE"])
        return dataclasses.replace(table, rotors=rotors, thr_mdl_fac=factor, airmode=airmode)

    def command(self, roll: float, pitch: float, yaw: float, thrust: float) -> NDArray[np.float64]:
        """(N,) motor commands in 0..1 of a normalised torque and an upward thrust in 0..1."""
        mix, command = self.mix, np.zeros(self._rotors)
        if mix is not None:
            with np.errstate(all="ignore"):
                u = mix.throttle(mix.setpoints((roll, pitch, yaw, 0.0, 0.0, -thrust)))
            command[: len(u)] = u[: self._rotors]
        return command
