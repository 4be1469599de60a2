"""The ladder of rotor models, a dictionary of terms a load (Berra, Trujillo and Heredia 2024, section 3).

srm    f = k u^2, one k for both rotors: a coaxial rotor is a rotor (eq. 18's standard mixer)
cpcm   f_u = k u_u^2, f_l = c k u_l^2: a constant penalty on the lower rotor (their reference 21)
rcrm   f_u = p_0u u_u^2, f_l = p_0l u_l^2 + p_1l u_u^2 (eq. 6)
crm    f_u a polynomial of u_u, f_l one of (u_u, u_l), terms chosen by LASSO up to an order (eq. 1-4)
surface  a smooth surface over both speeds, where no such polynomial follows (not in the paper; rotor.smooth)
mutual crm whose upper rotor may feel the lower one as well (not in the paper)
"""

from __future__ import annotations

from coaxlink.load import Load
from coaxlink.rotor.polynomial import dictionary, term_name

FORMS = ("srm", "cpcm", "rcrm", "crm", "surface")
SURFACE_DEGREE = 6  # of both speeds together: bumps wider than a fifth of their range
SQUARES = {"upper": ["u_u^2"], "lower": ["u_l^2"]}


def load_terms(form: str, load: str, order: int = 2) -> list[str]:
    """Names of the dictionary's terms for one load; `order` counts for crm and mutual only.

    Raises ValueError on an unknown form.
    """
    side = load.split(".")[0]
    if form in ("srm", "cpcm"):
        return SQUARES[side]
    if form == "rcrm":
        return SQUARES["upper"] if side == "upper" else ["u_l^2", "u_u^2"]
    if form == "crm":
        return [term_name(a, 0) for a in range(order + 1)] if side == "upper" else dictionary(order, order)
    if form == "mutual":
        return dictionary(order, order)
    if form == "surface":
        degrees = range(SURFACE_DEGREE + 1)
        return [term_name(a, b) for a in degrees for b in degrees if a + b <= SURFACE_DEGREE]
    raise ValueError(f"'{form}' is not a form: {', '.join(FORMS)}")


def is_selected(form: str) -> bool:
    """Whether LASSO chooses among the terms; the other forms keep all they name."""
    return form in ("crm", "mutual")


def shared_load(form: str, load: str) -> str | None:
    """The load whose coefficient this one shares (srm: the lower rotor has the upper one's k)."""
    if form == "srm" and load.startswith("lower"):
        return Load.of(load).partner.key
    return None
