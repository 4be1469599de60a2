"""The four loads of a coaxial pair: one name each, and every spelling that files, logs and results use."""

from __future__ import annotations

from enum import IntEnum


class Load(IntEnum):
    """A load; its number is its place in every array of the four, `(rows, 4)`.

    >>> Load.UPPER_THRUST.key, Load.UPPER_THRUST.column, Load.UPPER_THRUST.channel
    ('upper.thrust_N', 'upper_thrust_N', 'upper_thrust')
    >>> Load.of("lower.torque_Nm") is Load.LOWER_TORQUE, Load.LOWER_TORQUE.partner.name
    (True, 'UPPER_TORQUE')
    """

    UPPER_THRUST = 0
    UPPER_TORQUE = 1
    LOWER_THRUST = 2
    LOWER_TORQUE = 3

    @property
    def side(self) -> str:
        """upper or lower."""
        return ("upper", "lower")[self.rotor]

    @property
    def rotor(self) -> int:
        """Of the pair's two speeds, whose it is: 0 upper, 1 lower."""
        return int(self >= Load.LOWER_THRUST)

    @property
    def quantity(self) -> str:
        """thrust or torque."""
        return "torque" if self % 2 else "thrust"

    @property
    def unit(self) -> str:
        """As a reader has it: N or N m."""
        return "N m" if self % 2 else "N"

    @property
    def key(self) -> str:
        """In rotor files and in JSON: upper.thrust_N."""
        return f"{self.side}.{self._with_unit}"

    @property
    def column(self) -> str:
        """In logs: upper_thrust_N."""
        return f"{self.side}_{self._with_unit}"

    @property
    def channel(self) -> str:
        """In results, and as an attribute of PairLoads and RotorModel: upper_thrust."""
        return f"{self.side}_{self.quantity}"

    @property
    def label(self) -> str:
        """For a picture's axis: upper thrust, N."""
        return f"{self.side} {self.quantity}, {self.unit}"

    @property
    def partner(self) -> Load:
        """The same quantity of the pair's other rotor."""
        return Load((self + 2) % 4)

    @property
    def _with_unit(self) -> str:
        return f"{self.quantity}_{self.unit.replace(' ', '')}"

    @classmethod
    def of(cls, name: str) -> Load:
        """The load of a key, a column or a channel. Raises KeyError."""
        return _BY_NAME[name]


def of_rotor(rotor: int) -> tuple[Load, Load]:
    """Thrust and torque of the upper (0) or the lower (1) rotor."""
    return (Load.UPPER_THRUST, Load.UPPER_TORQUE) if rotor == 0 else (Load.LOWER_THRUST, Load.LOWER_TORQUE)


_BY_NAME = {name: load for load in Load for name in (load.key, load.column, load.channel)}


LOADS = tuple(load.key for load in Load)  # as files spell them
