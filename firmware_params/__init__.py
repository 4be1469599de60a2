"""What autopilot tables can say, and the mix each firmware will make of them. Knows no link, no model fit."""

FIRMWARES = ("px4", "ardupilot")
