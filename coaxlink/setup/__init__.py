"""A vehicle file from a board's parameters, a file or log that holds them, or a template; and its checks."""

from coaxlink.setup.ardupilot_source import ardupilot_layout
from coaxlink.setup.checks import check_against, check_airframe, check_outputs
from coaxlink.setup.complete import Body, MissingError, completed, inertia_estimate, missing
from coaxlink.setup.document import airframe_toml
from coaxlink.setup.drawing import draw
from coaxlink.setup.layout import Layout, Mount
from coaxlink.setup.sources import TEMPLATES, px4_layout, template

__all__ = [
    "TEMPLATES",
    "Body",
    "Layout",
    "MissingError",
    "Mount",
    "airframe_toml",
    "ardupilot_layout",
    "check_against",
    "check_airframe",
    "check_outputs",
    "completed",
    "draw",
    "inertia_estimate",
    "missing",
    "px4_layout",
    "template",
]
