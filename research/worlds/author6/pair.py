"""What both rigs share: a pair's aerodynamics, noise by its spectrum, the oracle.

Rotors are annuli in closed-form blade-element momentum balance, the lower one in the contracting jet of the
upper one (Leishman 2006, 3.3 and 2.14). Noise lies on a circle of rows, so that its covariance, and with it
the oracle's generalised least squares, is exact.
"""

from types import SimpleNamespace

import numpy as np

RHO, SLOPE, STATION = 1.2, 5.7, np.linspace(0.2, 0.95, 6)  # kg/m3, lift a radian, of the radius
FAINT, NEAR, FREE = 10.0, 6.0, 1e3  # nats, nats, standard deviations that an unbounded term may reach
LOADS = ("upper_thrust", "upper_torque", "lower_thrust", "lower_torque")


def sizes(text):
    """{name: (the size that is tried first, the largest)}."""
    return {r.split()[0]: tuple(map(float, r.split()[1:])) for r in text.split(",")}


def draw_pair(rng):
    """Two equal rotors on one axis: m, of the diameter, -, rad, -, m, rad/s."""
    radius = rng.uniform(0.16, 0.36)
    keys = ("pitch", "solidity", "stall", "profile", "gap", "top")
    drawn = rng.uniform([0.28, 0.075, 0.2, 0.012, 0.3 * radius, 130 / radius],
                        [0.42, 0.11, 0.28, 0.02, 0.9 * radius, 190 / radius])  # fmt: skip
    return SimpleNamespace(radius=radius, **dict(zip(keys, drawn, strict=True)))


def blade(p, speed, flow, rho):
    """Thrust (N) and torque (N m) at a speed (rad/s) in an axial flow (m/s, a value a station)."""
    tip = np.maximum(speed, 0.03 * p.top)[..., None] * p.radius
    half = p.solidity * SLOPE / 16 - 0.5 * flow / tip
    theta = np.arctan(p.pitch / (np.pi * STATION)) + 0.03
    slant = (np.sqrt(half**2 + p.solidity * SLOPE * theta * STATION / 8) - half) / STATION
    angle = theta - slant
    lift = SLOPE * angle / (1 + (angle / p.stall) ** 4) ** 0.25 / np.sqrt(1 - (tip * STATION / 340) ** 2)
    drag = p.profile * (tip / (p.top * p.radius)) ** -0.3 + 0.8 * np.minimum(np.abs(angle), 0.6) ** 2
    push = 0.5 * rho[..., None] * (tip * STATION * p.radius) ** 2 * p.solidity * np.pi * 0.15
    return 0.97 * np.sum(lift * push, -1), np.sum((lift * slant + drag) * push * STATION * p.radius, -1)


def pair_loads(p, upper, lower, rho=RHO, climb=0.0, gap=None, back=0.0):
    """Four loads of a pair; `back` is the share of the lower rotor's flow that the upper one feels."""
    rho, climb = np.broadcast_arrays(rho, climb, upper)[:2]
    wake = 0.73 + 0.27 * np.exp(-1.4 * np.asarray(p.gap if gap is None else gap)[..., None] / p.radius)
    inside = 1 / (1 + np.exp((STATION - wake) / 0.06)) / wake**2
    area, drawn = 2 * np.pi * p.radius**2, np.zeros_like(upper)
    for _ in range(3 if back else 1):
        above = blade(p, upper, (climb + drawn)[..., None], rho)
        jet = np.sqrt(np.maximum(above[0], 0) / (rho * area))[..., None] * inside
        below = blade(p, lower, climb[..., None] + jet, rho)
        drawn = back * np.sqrt(np.maximum(below[0], 0) / (rho * area))
    return np.stack([*above, *below])


def crm(p, loads, u, rng):
    """A coaxial rotor model (TOML) fitted to a clean run of noise 0.3 %."""
    text = f'form = "crm"\nspeed_max_rpm = {p.top * 30 / np.pi:.1f}\n'
    for name, y in zip(LOADS, loads, strict=True):
        terms = [(1, 0), (2, 0)] if name[0] == "u" else [(i, j) for i in range(3) for j in range(3)]
        a = np.column_stack([u[0] ** i * u[1] ** j for i, j in terms])
        fit = np.linalg.lstsq(a, y + 0.003 * np.ptp(y) * rng.standard_normal(y.size), rcond=None)[0]
        text += "\n[{}.{}]\n".format(*name.split("_")).replace("st]", "st_N]").replace("que]", "que_Nm]")
        for (i, j), c in zip(terms, fit, strict=True):
            text += f'"{" ".join(f"{s}^{k}" for s, k in (("u_u", i), ("u_l", j)) if k) or 1}" = {c:.7g}\n'
    return text.replace('^1"', '"').replace("^1 ", " ")


def colour(psd, n, rng):
    """Noise of a spectrum of mean 1."""
    return np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) * np.sqrt(psd), n)


def whiten(x, psd):
    return np.fft.irfft(np.fft.rfft(x) / np.sqrt(psd), x.shape[-1])


def weigh(signs, nuisance, rivals):
    """Of whitened signs {name: y}: {name: (nats against none, {rival: nats against it})}."""
    pool = [x.ravel() for x in (*nuisance, *signs.values())]
    places = {name: len(nuisance) + k for k, name in enumerate(signs)}
    spans = {}
    for name, many in rivals.items():
        spans[name] = [len(pool) + k for k in range(len(many))]
        pool += [FREE * x.ravel() / max(np.linalg.norm(x), 1e-12) for x in many]
    gram = np.array(pool) @ np.array(pool).T

    def left(k, given):
        g = gram[np.ix_(given, given)] + np.eye(len(given))
        return 0.5 * float(gram[k, k] - gram[k, given] @ np.linalg.solve(g, gram[given, k]))

    out = {}
    for name, k in places.items():
        base = [*range(len(nuisance)), *(v for v in places.values() if v != k)]
        out[name] = left(k, base), {r: left(k, base + s) for r, s in spans.items() if r not in signs}
    return out


def resize(size, weighed, want, drawn, bound):
    """The size of `want` nats (13: visible, 2500: clear); of ambiguous worlds the best rival loses by 4."""
    nats, near = weighed
    factor = want / max(nats, 1e-9)
    if drawn == "ambiguous":
        factor = min(factor, 4 / max(min(near.values(), default=1.0), 1e-9))
    return float(min(size * np.sqrt(factor), bound))


def verdict(drawn, weighed):
    """Truth of what was drawn and what the oracle can tell of it."""
    near = {n: sorted(r for r, v in rest.items() if v < NEAR) for n, (_, rest) in weighed.items()}
    best = {n: min(rest.items(), key=lambda p: p[1], default=("", 0.0)) for n, (_, rest) in weighed.items()}
    faint = [n for n in near if weighed[n][0] < FAINT]
    kind, effects, accept = drawn, list(near), []
    if drawn in ("odd", "fault"):
        effects = []
        accept = [[r] for r in near["odd"]] if drawn == "odd" else [["nothing"]] * bool(faint)
        kind = "clean" if drawn == "odd" and faint else drawn
    elif drawn == "ambiguous" and near[effects[0]] and not faint:
        effects = [*effects, best[effects[0]][0]]
    elif effects:
        kind, accept = "two" if len(effects) > 1 else "effect", [[]]
        for n in near:
            some = [[n], *([r] for r in near[n]), *([[]] if n in faint else [])]
            accept = [sorted({*a, *b}) for a in accept for b in some]
        if len(faint) == len(effects) or (kind == "effect" and len(accept) > 1):
            kind = "ambiguous"  # what the oracle cannot tell either
        accept += [sorted({*near, "rotor_drag"})] if "wind" in near else []
    truth = {"kind": kind, "drawn": drawn, "effects": effects, "accept": accept, "faint": faint}
    truth |= {"llr_null": min((round(v, 1) for v, _ in weighed.values()), default=None)}
    return truth | {"llr_rival": {n: round(v, 1) for n, (_, v) in best.items()}, "rival": best}
