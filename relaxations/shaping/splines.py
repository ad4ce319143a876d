"""Splines as commands, and what a shaper makes of them: splines again, in closed form.

    r(t) = Σ_k c_{i,k} (t - x_i)^k on [x_i, x_{i+1}),   `rest` before x_0, the last value from x_n on

Impulses give `Σ A_j r(t - t_j)`: the same degree, knots at every x_i + t_j, and there jumps of derivatives of A_j times those of r. A pulse
gives a difference of two integrals of r, one degree more. Nothing is sampled; where derivatives jump stays known.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from relaxations.commands import Command, Segment, Tail
from relaxations.errors import CommandError, ShaperError
from relaxations.shaping.shapers import Shaper

Reals = NDArray[np.float64]

FORMAT = "slewcert-spline/1"
HIGHEST, MOST_PIECES = 20, 2_000_000  # degree, and pieces: of a shaped spline, too
SAME_INSTANT = 1e-14  # of the duration: knots that differ by no more are one
NO_JUMP = 1e-9  # of the largest derivative of that order, over a whole piece: rounding
FITTED = 1e-6  # of the spline's largest excursion from its rest: how far lines may be from it


@dataclass(frozen=True, slots=True, eq=False)
class Spline:
    """`knots` (n + 1,) ascending [s] and `coefficients` (n, degree + 1) of the pieces between them, in ascending powers of the time since
    each piece's own start [s]; `rest` is the value before. Raises `CommandError` naming what is wrong.
    """

    knots: Reals
    coefficients: Reals
    rest: float = 0.0

    def __post_init__(self) -> None:
        knots, coefficients = (np.array(x, dtype=np.float64) for x in (self.knots, self.coefficients))
        if wrong := _mistakes(knots, coefficients, self.rest):
            raise CommandError("; ".join(wrong))
        for name, numbers in (("knots", knots), ("coefficients", coefficients)):
            numbers.setflags(write=False)
            object.__setattr__(self, name, numbers)

    @property
    def degree(self) -> int:
        """The highest power that its pieces may have."""
        return self.coefficients.shape[1] - 1

    @property
    def final(self) -> float:
        """The value that is held from the last knot on."""
        return float(_horner(self.coefficients[-1:], self.knots[-1:] - self.knots[-2:-1])[0])

    def __call__(self, times: ArrayLike) -> Reals:
        """Values at `times` [s], at a jump the one after it."""
        t = np.asarray(times, dtype=np.float64)
        piece = np.clip(np.searchsorted(self.knots, t, side="right") - 1, 0, len(self.coefficients) - 1)
        inside = _horner(self.coefficients[piece], t - self.knots[piece])
        return np.where(t < self.knots[0], self.rest, np.where(t >= self.knots[-1], self.final, inside))

    def jumps(self, order: int = 0) -> tuple[Reals, Reals]:
        """Instants (m,) [s] at which the derivative of this order jumps, first and last knot included, and by how much (m,)."""
        fall = np.array([math.perm(k, order) for k in range(self.degree + 1)], dtype=np.float64)
        slopes = (self.coefficients * fall)[:, order:] if order <= self.degree else np.zeros((len(self.coefficients), 1))
        widths = np.diff(self.knots)
        before = np.concatenate([[self.rest if order == 0 else 0.0], _horner(slopes, widths)])
        after = np.concatenate([slopes[:, 0], [before[-1] if order == 0 else 0.0]])
        steps = after - before
        # what rounding makes of a derivative is that of the value, over powers of the widths
        size = np.abs(self.coefficients) @ np.ones(self.degree + 1) if not order else np.abs(slopes).sum(axis=1)
        kept = np.abs(steps) > NO_JUMP * max(float(size.max()), 1e-300)
        return self.knots[kept], steps[kept]

    @property
    def communication_points(self) -> Reals:
        """Every instant at which a derivative of any order jumps, ascending [s]: an integrator starts anew there."""
        return np.unique(np.concatenate([self.jumps(order)[0] for order in range(self.degree + 1)]))

    @staticmethod
    def b_spline(knots: ArrayLike, coefficients: ArrayLike, degree: int, rest: float | None = None) -> Spline:
        """A B-spline as SciPy and most of CAD write it: knots (n + degree + 1,), coefficients (n,), over its base interval.

        `rest`: None for its first value. Raises `CommandError`.
        """
        from scipy.interpolate import BSpline, PPoly  # here: it takes long to load, and few commands are splines

        try:
            places, weights = np.asarray(knots, dtype=float), np.asarray(coefficients, dtype=float)
            found = PPoly.from_spline(BSpline(places, weights, degree, extrapolate=False))
        except (ValueError, TypeError) as problem:
            raise CommandError(f"no B-spline of degree {degree!r}: {problem}") from None
        x, c = np.asarray(found.x), np.asarray(found.c)
        base = slice(degree, len(x) - 1 - degree)
        starts, pieces = x[base], c[::-1, base].T
        wide = np.diff(np.append(starts, x[len(x) - 1 - degree])) > 0.0  # repeated knots: pieces without width
        return Spline.held(np.append(starts[wide], x[len(x) - 1 - degree]), pieces[wide], rest)

    @staticmethod
    def through(times: ArrayLike, values: ArrayLike, rest: float | None = None, degree: int = 3) -> Spline:
        """Through points: cubic with second derivative continuous and slope 0 at both ends, or (degree 1) lines. Raises `CommandError`."""
        t, y = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
        wrong = [f"there are {len(t)} times and {len(y)} values"] if len(t) != len(y) else []
        wrong += ["a spline goes through two points or more"] if len(t) < 2 else []
        wrong += _ascending(t) or ([] if np.isfinite(y).all() else ["a spline holds finite numbers only"])
        if degree not in (1, 3):
            wrong.append(f"points are joined by lines (degree 1) or cubics (3), not by degree {degree!r}")
        if wrong:
            raise CommandError("; ".join(wrong))
        if degree == 1:
            return Spline.held(t, np.array([y[:-1], np.diff(y) / np.diff(t)]).T, rest)
        from scipy.interpolate import CubicSpline

        return Spline.held(t, np.asarray(CubicSpline(t, y, bc_type="clamped").c)[::-1].T, rest)

    @staticmethod
    def held(knots: ArrayLike, coefficients: ArrayLike, rest: float | None = None) -> Spline:
        """One that rests at its first value before (`rest` None)."""
        pieces = np.asarray(coefficients, dtype=float)
        return Spline(np.asarray(knots, dtype=float), pieces, float(pieces[0, 0]) if rest is None and pieces.size else rest or 0.0)

    def to_dict(self) -> dict[str, Any]:
        """The spline file as plain data (`slewcert-spline/1`)."""
        return {"format": FORMAT, "rest": self.rest, "knots": self.knots.tolist(), "coefficients": self.coefficients.tolist()}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Spline:
        """The inverse of `to_dict`; also `degree` with knots and coefficients of a B-spline, or `points` [[t, value], …].

        Raises `CommandError` naming what is malformed.
        """
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            found = data.get("format") if isinstance(data, Mapping) else type(data).__name__
            raise CommandError(f'a spline file has "format": "{FORMAT}"; this one has {found!r}')
        try:
            rest = None if data.get("rest") is None else float(data["rest"])
            if "points" in data:
                points = np.array([(float(t), float(y)) for t, y in data["points"]], dtype=float).reshape(-1, 2)
                return Spline.through(points[:, 0], points[:, 1], rest, int(data.get("degree", 3)))
            knots = [float(x) for x in data["knots"]]
            if "degree" in data:
                return Spline.b_spline(knots, [float(c) for c in data["coefficients"]], int(data["degree"]), rest)
            pieces = [[float(c) for c in piece] for piece in data["coefficients"]]
            most = max(map(len, pieces), default=0)
            return Spline.held(knots, np.array([piece + [0.0] * (most - len(piece)) for piece in pieces]).reshape(len(pieces), most), rest)
        except (KeyError, TypeError, ValueError, OverflowError) as problem:
            raise CommandError(f"malformed spline file: {type(problem).__name__} {problem}") from None

    @staticmethod
    def from_json(text: str) -> Spline:
        """Read a spline file's text."""
        try:
            data = json.loads(text)
        except (ValueError, RecursionError) as problem:
            raise CommandError(f"a spline file is JSON: {problem}") from None
        return Spline.from_dict(data)

    def lines(self, accuracy: float = FITTED) -> Command:
        """A command of slopes within `accuracy` times the largest excursion, with a switch at every knot. Raises `CommandError`.

        Chords of a piece of width w in m parts are within `max|r''| (w/m)²/8` of it.
        """
        widths = np.diff(self.knots)
        powers = np.arange(self.degree + 1)
        bend = np.zeros(len(widths))
        for k in range(2, self.degree + 1):
            bend += k * (k - 1) * np.abs(self.coefficients[:, k]) * widths ** (k - 2)
        size = float((np.abs(self.coefficients[:, 1:]) * widths[:, None] ** powers[1:]).sum(axis=1).max(initial=0.0))
        size = max(size, abs(self.final - self.rest), float(np.abs(self.coefficients[:, 0] - self.rest).max()), 1e-300)
        parts = np.maximum(np.ceil(widths * np.sqrt(bend / (8.0 * accuracy * size))), 1.0)
        if parts.sum() > MOST_PIECES:
            raise CommandError(f"lines within {accuracy:g} of this spline are {parts.sum():.3g}, more than {MOST_PIECES}")
        segments = []
        counts = parts.astype(int).tolist()
        for start, width, count, piece in zip(self.knots[:-1].tolist(), widths.tolist(), counts, self.coefficients, strict=True):
            at = np.linspace(0.0, width, count + 1)
            values = _horner(np.broadcast_to(piece, (count + 1, len(piece))), at)
            segments += [
                Segment(start + float(t), float(a), float(slope))
                for t, a, slope in zip(at[:-1], values[:-1], np.diff(values) / np.diff(at), strict=True)
            ]
        return Command(float(self.knots[-1] - self.knots[0]), tuple(segments), Tail(self.final))


def shape_spline(spline: Spline, shaper: Shaper) -> Spline:
    """The shaped spline, a spline: exact but for rounding.

    Raises `ShaperError` for a shaper with decaying terms, `CommandError` for one of more pieces than can be held.
    """
    if shaper.terms:
        raise ShaperError("a shaper with decaying terms makes no spline of a spline; it runs as an FMU (slewcert fmus export)")
    edges, weights, order = shaper.excitation
    if len(edges) * len(spline.knots) > MOST_PIECES:
        raise CommandError(f"{len(spline.knots)} knots and {len(edges)} impulses make more than {MOST_PIECES} pieces")
    starts, pieces = _integrated(spline) if order else (spline.knots, spline.coefficients)
    knots = np.unique(np.add.outer(np.asarray(edges), spline.knots))
    span = float(knots[-1] - knots[0])
    knots = knots[np.append(True, np.diff(knots) > SAME_INSTANT * span)]
    at, middles = knots[:-1], (knots[:-1] + knots[1:]) / 2.0
    constant = np.zeros((1, pieces.shape[1]))
    constant[0, 0] = 1.0
    # Before the first knot and behind the last one r (or its integral) is a polynomial, too.
    first, last = spline.rest * constant, spline.final * constant
    if order:
        first, last = np.zeros_like(constant), np.zeros_like(constant)
        first[0, :2], last[0, :2] = (0.0, spline.rest), (_horner(pieces[-1:], np.diff(starts)[-1:])[0], spline.final)
    table = np.vstack([first, pieces, last])
    origins = np.concatenate([starts[:1], starts])
    total = np.zeros((len(at), pieces.shape[1]))
    for edge, weight in zip(edges, weights, strict=True):
        piece = np.searchsorted(starts, middles - edge, side="right")
        total += weight * _moved(table[piece], at - edge - origins[piece])
    return Spline(knots, total, spline.rest)


def _mistakes(knots: Reals, coefficients: Reals, rest: float) -> list[str]:
    if knots.ndim != 1 or coefficients.ndim != 2 or len(coefficients) == 0 or len(knots) != len(coefficients) + 1:
        return [
            f"a spline of n pieces has n + 1 knots and n rows of coefficients; these are of shapes {knots.shape} and {coefficients.shape}"
        ]
    wrong = _ascending(knots)
    if not (np.isfinite(coefficients).all() and math.isfinite(rest)):
        wrong.append("a spline holds finite numbers only")
    if not 1 <= coefficients.shape[1] <= HIGHEST + 1:
        wrong.append(f"a spline's degree is at most {HIGHEST}, not {coefficients.shape[1] - 1}")
    if len(coefficients) > MOST_PIECES:
        wrong.append(f"a spline has at most {MOST_PIECES} pieces, not {len(coefficients)}")
    return wrong


def _ascending(instants: Sequence[float] | Reals) -> list[str]:
    t = np.asarray(instants, dtype=float)
    if not np.isfinite(t).all():
        return ["a spline's instants are finite"]
    if len(t) and t[0] < 0.0:
        return [f"a spline begins at 0 s or later, not at {float(t[0])!r} s"]
    steps = np.flatnonzero(np.diff(t) <= 0.0)
    return [f"a spline's instants ascend: {float(t[i + 1])!r} s follows {float(t[i])!r} s" for i in steps[:1].tolist()]


def _horner(coefficients: Reals, since: Reals) -> Reals:
    """Each row's polynomial (…, degree + 1) at its own place (…,)."""
    total = np.zeros(np.shape(since))
    for k in range(coefficients.shape[-1] - 1, -1, -1):
        total = total * since + coefficients[..., k]
    return total


def _moved(coefficients: Reals, by: Reals) -> Reals:
    """The polynomials in powers of the time since places that lie so much later (synthetic division)."""
    moved = coefficients.copy()
    for i in range(moved.shape[1] - 1):
        for j in range(moved.shape[1] - 2, i - 1, -1):
            moved[:, j] += by * moved[:, j + 1]
    return moved


def _integrated(spline: Spline) -> tuple[Reals, Reals]:
    """Knots and pieces of its integral from the first knot on."""
    powers = np.arange(1, spline.degree + 2)
    pieces = np.hstack([np.zeros((len(spline.coefficients), 1)), spline.coefficients / powers])
    areas = _horner(pieces, np.diff(spline.knots))
    pieces[:, 0] = np.concatenate([[0.0], np.cumsum(areas)[:-1]])
    return spline.knots, pieces
