"""Boxes of the edges of pulses: every command is in one of the halves; what order and width exclude; the lines of an envelope."""

from __future__ import annotations

import random
from fractions import Fraction
from itertools import pairwise, product
from types import SimpleNamespace
from typing import Any

import pytest
from flint import fmpq

from relaxations.checking import pulses
from relaxations.checking.reading import Malformed

F = Fraction


def exactly(x: Fraction) -> fmpq:
    return fmpq(x.numerator, x.denominator)


def command(rng: random.Random, count: int, width: Fraction, time: Fraction) -> list[tuple[Fraction, Fraction]]:
    """Pulses in order; each as wide as it must be, or wider."""
    spare = sorted(F(rng.randint(0, 12), 12) * (time - count * width) for _ in range(2 * count))
    return [(spare[2 * i] + i * width, spare[2 * i + 1] + (i + 1) * width) for i in range(count)]


def holds(box: pulses.Box | None, edges: list[tuple[Fraction, Fraction]], signs: list[int]) -> bool:
    return box is not None and all(
        one.begin[0] <= exactly(x) <= one.begin[1] and one.end[0] <= exactly(y) <= one.end[1] and one.sign in (0, sign)
        for one, (x, y), sign in zip(box, edges, signs, strict=True)
    )


@pytest.mark.parametrize("seed", range(50))
def test_every_command_is_in_one_of_the_halves(seed: int) -> None:
    rng, width, time = random.Random(seed), F(1, 2), F(4)
    count = rng.randint(1, 4)
    limited: Any = SimpleNamespace(lower=fmpq(-1), upper=fmpq(1))
    edges, signs = command(rng, count, width, time), [rng.choice((-1, 1)) for _ in range(count)]
    box = pulses.tight(pulses.whole(count, exactly(time), limited), exactly(width))
    assert holds(box, edges, signs)
    for _ in range(12):
        assert box is not None
        pulse = rng.randrange(count)
        edge = rng.choice(["begin", "end", *(["sign"] if box[pulse].sign == 0 else [])])
        at = exactly(rng.choice([*edges[pulse], F(rng.randint(-4, 20), 4)]))
        parts = [pulses.tight(part, exactly(width)) for part in pulses.halves(box, SimpleNamespace(pulse=pulse, edge=edge, at=at))]
        held = [part for part in parts if holds(part, edges, signs)]
        assert held
        for part in parts:  # nothing is in neither half of what it was, and what is tight stays so
            assert part is None or all(
                old.begin[0] <= new.begin[0] <= new.begin[1] <= old.begin[1] and old.end[0] <= new.end[0] <= new.end[1] <= old.end[1]
                for old, new in zip(box, part, strict=True)
            )
            assert part is None or pulses.tight(part, exactly(width)) == part
        if edge != "sign" and box[pulse].begin[0] < box[pulse].begin[1] and box[pulse].end[0] < box[pulse].end[1]:
            assert any(part is None or part != box for part in parts)
        box = rng.choice(held)


def test_halves_meet_at_the_instant_where_they_are_split() -> None:
    limited: Any = SimpleNamespace(lower=fmpq(-1), upper=fmpq(1))
    box = pulses.whole(2, fmpq(5), limited)
    for pulse, edge in product((0, 1), ("begin", "end")):
        low, high = (getattr(part[pulse], edge) for part in pulses.halves(box, SimpleNamespace(pulse=pulse, edge=edge, at=fmpq(2))))
        assert (low, high) == ((0, 2), (2, 5))
        for part in pulses.halves(box, SimpleNamespace(pulse=pulse, edge=edge, at=fmpq(2))):
            assert part[1 - pulse] == box[1 - pulse]
            assert getattr(part[pulse], "end" if edge == "begin" else "begin") == (0, 5)
    up, down = pulses.halves(box, SimpleNamespace(pulse=1, edge="sign", at=fmpq(2)))
    assert [one.sign for one in (*up, *down)] == [0, 1, 0, -1]
    with pytest.raises(Malformed, match="splits number 2"):
        pulses.halves(box, SimpleNamespace(pulse=2, edge="end", at=fmpq(2)))


def test_order_and_width_tighten_a_box() -> None:
    limited: Any = SimpleNamespace(lower=fmpq(-1), upper=fmpq(1))
    box = pulses.tight(pulses.whole(2, fmpq(5), limited), fmpq(1))
    assert box is not None
    assert [(one.begin, one.end) for one in box] == [((0, 3), (1, 4)), ((1, 4), (2, 5))]
    assert pulses.tight(pulses.whole(5, fmpq(5), limited), fmpq(1)) is not None
    assert pulses.tight(pulses.whole(6, fmpq(5), limited), fmpq(1)) is None
    for begin, ends, kept in (((0, 5), (0, F(1, 2)), False), ((4, 5), (0, 5), True), ((4, 5), (0, 4), False), ((3, 5), (0, 4), True)):
        odd = pulses.Range((exactly(F(begin[0])), exactly(F(begin[1]))), (exactly(F(ends[0])), exactly(F(ends[1]))))
        assert (pulses.tight((odd,), fmpq(1)) is not None) is kept
    for low, high, sign in ((-1, 1, 0), (0, 1, 1), (-1, 0, -1)):
        limited = SimpleNamespace(lower=fmpq(low), upper=fmpq(high))
        assert pulses.whole(1, fmpq(5), limited)[0].sign == sign


def test_lines_of_an_envelope() -> None:
    rng = random.Random(5)
    for _ in range(200):
        lines = [(fmpq(rng.randint(-3, 3)), fmpq(rng.randint(-5, 5), rng.randint(1, 3))) for _ in range(rng.randint(1, 6))]
        hull = pulses.envelope(lines)
        for x in (fmpq(k, 7) for k in range(-60, 61, 3)):
            assert max(m * x + c for m, c in hull) == max(m * x + c for m, c in lines)
        turns = [(c - d) / (n - m) for (m, c), (n, d) in pairwise(hull)]
        assert turns == sorted(turns)
