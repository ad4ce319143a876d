"""Trees of pulses by hand: known minimum times, both sides of inequality (3a) in fractions, boxes of edges that hold their commands."""

from __future__ import annotations

import copy
import random
from fractions import Fraction
from itertools import pairwise
from typing import Any

import pytest
from flint import fmpq
from forgery import certificate, costate, number, posed, task, written

from relaxations.checking import lower, pulses
from relaxations.checking.balls import work
from relaxations.checking.claims import Outcome, check
from relaxations.checking.reading import LEAF, PULSES, Undecided, shaped

F = Fraction
Four = tuple[Fraction, Fraction, Fraction, Fraction]  # where a pulse may begin and end in time to go
Leaf = dict[str, Any]


def leaf(*coefficients: Any, widths: Any = (), fuel: Any = 0, near: tuple[str, str] = ("0", "0")) -> Leaf:
    """A costate of one chain, prices of widths and of fuel."""
    chain = {"near": list(near), "coefficients": [[written(F(c)), "0"] for c in coefficients]}
    return {"costate": [[chain]], "widths": [written(F(w)) for w in widths], "fuel": written(F(fuel))}


def end(*coefficients: Any, **others: Any) -> dict[str, Any]:
    """A node that refutes."""
    return {"split": None, "leaf": leaf(*coefficients, **others)}


def split(pulse: int, edge: str, at: str = "0") -> dict[str, Any]:
    """A node with two halves."""
    return {"split": {"pulse": pulse, "edge": edge, "at": at}, "leaf": None}


def verdict(of: dict[str, Any], claimed: Any, *nodes: dict[str, Any]) -> Outcome:
    return check(certificate(of, lower=claimed, witnesses=({**costate(), "pulses": list(nodes)}, None))).outcome


# One integrator: whatever is done its area counts alone. 2.5 s forth and 1.5 s back.

SLOW = task(["1"], ["1", "0"], pulse_width="1.5")
NONE, LITTLE, BACK = end(1), end(-1, widths=[1]), end(1, widths=[0])
TWICE = [
    split(0, "sign"),
    split(1, "sign"),
    end(-1, widths=[1, 1]),
    end(1, widths=[0, 2]),
    split(1, "sign"),
    end(1, widths=[2, 0]),
    end(1, widths=[0, 0]),
]
TREES = [NONE, split(0, "sign"), LITTLE, BACK, *TWICE]


def test_a_tree_by_hand_proves_the_minimum_time_to_the_last_digit() -> None:
    assert verdict(SLOW, "3.999999999999", *TREES) is Outcome.PROVED
    assert verdict(SLOW, "4", *TREES) is not Outcome.PROVED
    assert verdict(task(["1"], ["1", "0"], pulse_width="1.5", pulses=3), "3.999999999999", *TREES) is Outcome.PROVED
    assert verdict(task(["1"], ["1", "0"], pulse_width="1.5", pulses=1), "9", *TREES[:4]) is Outcome.PROVED  # one pulse never does


def test_no_part_can_be_left_out() -> None:
    for i in range(len(TREES)):
        assert verdict(SLOW, "3.9", *TREES[:i], *TREES[i + 1 :]) is not Outcome.PROVED
        assert verdict(SLOW, "3.9", *TREES[:i], TREES[i], *TREES[i:]) is not Outcome.PROVED
        for j in range(i % 3, i, 3):
            others = [*TREES]
            others[i], others[j] = others[j], others[i]
            assert (verdict(SLOW, "3.9", *others) is Outcome.PROVED) is (others == TREES)
    assert verdict(SLOW, "3.9", *TREES, NONE) is Outcome.MALFORMED
    assert verdict(SLOW, "4.5", *TREES) is Outcome.INCONCLUSIVE  # three pulses fit


def test_what_does_not_fit_needs_a_node_and_no_reason() -> None:
    """In 2.9 s there are no two pulses of 1.5 s; in 3 s there are, though without any play."""
    assert verdict(SLOW, "2.9", *TREES[:4]) is Outcome.PROVED
    assert verdict(SLOW, "3", *TREES[:4]) is Outcome.INCONCLUSIVE
    assert verdict(SLOW, "3", *TREES) is Outcome.PROVED
    # A split at an instant that leaves one half without a place for the pulse: nothing has to be said of that half.
    for edge, at, empty in (("begin", "3", 1), ("begin", "-1", 0), ("end", "1", 0), ("end", "4", 1)):
        halves = [end(0), LITTLE][:: 1 if empty == 0 else -1]
        assert verdict(SLOW, "2.9", NONE, split(0, "sign"), split(0, edge, at), *halves, BACK) is Outcome.PROVED
        assert verdict(SLOW, "2.9", NONE, split(0, "sign"), split(0, edge, at), *halves[::-1], BACK) is not Outcome.PROVED
    assert (
        verdict(SLOW, "2.9", NONE, split(0, "sign"), split(0, "begin", "3"), LITTLE, split(0, "end"), end(0), end(0), BACK)
        is Outcome.PROVED
    )


def test_pulses_without_a_width_may_last_no_time() -> None:
    """At most two pulses, one of them may be none: one tree says it all, and 1 s is the minimum time."""
    of = task(["1"], ["1", "0"], pulses=2)
    assert verdict(of, "0.999999999", end(1, widths=[0, 0])) is Outcome.PROVED
    assert verdict(of, "1", end(1, widths=[0, 0])) is not Outcome.PROVED
    assert verdict(of, "0.49", end(1, widths=[1, 1])) is Outcome.PROVED  # prices of no width are a loss
    assert verdict(of, "0.51", end(1, widths=[1, 1])) is not Outcome.PROVED


def test_a_costate_without_trees_needs_no_pulses() -> None:
    for of in (task(["1"], ["1", "0"]), SLOW):
        plain = costate((("0", "0"), [("1", "0")]))
        assert check(certificate(of, lower="0.999", witnesses=({**plain, "pulses": []}, None))).outcome is Outcome.PROVED


def test_a_budget_of_fuel_counts_in_every_part() -> None:
    """4 units of fuel take 4 s; with less than 4 nothing does."""
    fuel = [
        split(0, "sign"),
        split(1, "sign"),
        end(-1, widths=[1, 1]),
        end(1, widths=[0, 2], fuel=1),
        split(1, "sign"),
        end(1, widths=[2, 0], fuel=1),
        BACK,
    ]
    trees = [NONE, split(0, "sign"), LITTLE, BACK, *fuel[:-1], end(1, widths=[0, 0])]
    assert verdict(task(["1"], ["1", "0"], pulse_width="1.5", fuel="3.999999"), "4.49", *trees) is Outcome.PROVED
    assert verdict(task(["1"], ["1", "0"], pulse_width="1.5", fuel="4"), "4.49", *trees) is not Outcome.PROVED
    assert verdict(SLOW, "3.9", *trees) is Outcome.MALFORMED  # a price without a budget


@pytest.mark.parametrize(("limits", "way", "known"), [(("-1", "2"), "1", "1.7"), (("-2", "1"), "-1", "1.7"), (("-1", "2"), "-1", "1")])
def test_signs_are_those_of_the_limits(limits: tuple[str, str], way: str, known: str) -> None:
    """0.9 s at 2, 0.8 s at -1; the other way 1 s at -1 is enough."""
    of = task(["1"], ["1", "0"], way, limits=limits, pulse_width="0.8")
    side = 1 if way == "1" else -1
    more, less = (F(limits[1]), -F(limits[0])) if side > 0 else (-F(limits[0]), F(limits[1]))
    if more < less:  # one long pulse against nothing
        assert verdict(of, "0.999", end(side), end(side, widths=[0])) is Outcome.PROVED
        assert verdict(of, "1", end(side), end(side, widths=[0])) is not Outcome.PROVED
        return
    along, across = end(-side, widths=[more]), end(side, widths=[0])
    both, mixed, turned = end(-side, widths=[more, more]), end(side, widths=[0, more + less]), end(side, widths=[more + less, 0])
    none = end(side, widths=[0, 0])
    if side > 0:
        trees = [
            end(side),
            split(0, "sign"),
            along,
            across,
            split(0, "sign"),
            split(1, "sign"),
            both,
            mixed,
            split(1, "sign"),
            turned,
            none,
        ]
    else:
        trees = [
            end(side),
            split(0, "sign"),
            across,
            along,
            split(0, "sign"),
            split(1, "sign"),
            none,
            turned,
            split(1, "sign"),
            mixed,
            both,
        ]
    close = written(F(known) - F(1, 10**9))
    assert verdict(of, close, *trees) is Outcome.PROVED
    assert verdict(of, known, *trees) is not Outcome.PROVED


def test_one_way_pulses_need_no_split_of_their_sign() -> None:
    for limits, way in ((("0", "1"), "1"), (("-1", "0"), "-1")):
        of, side = task(["1"], ["1", "0"], way, limits=limits, pulse_width="1.5"), int(way)
        assert verdict(of, "2.9", end(side), end(-side, widths=[1])) is Outcome.PROVED
        assert verdict(of, "2.9", end(side), split(0, "sign"), end(-side, widths=[1]), end(side, widths=[0])) is Outcome.MALFORMED


def test_what_is_no_tree_is_malformed() -> None:
    both = {"split": split(0, "sign")["split"], "leaf": leaf(1)}
    for nodes in (
        [{"split": None, "leaf": None}, *TREES[1:]],
        [both, *TREES[1:]],
        [end(1, widths=[0]), *TREES[1:]],  # of no pulses there are no widths
        [*TREES[:2], end(-1), *TREES[3:]],
        [*TREES[:2], end(-1, widths=[1, 0]), *TREES[3:]],
        [*TREES[:2], end(-1, widths=[-1]), *TREES[3:]],
        [end(1, fuel=-1), *TREES[1:]],
        [end(1, fuel=1), *TREES[1:]],
        [NONE, split(1, "sign"), *TREES[2:]],  # a pulse that is not there
        [split(0, "begin"), NONE, NONE, *TREES[1:]],
        [NONE, split(0, "sign"), split(0, "sign"), LITTLE, LITTLE, BACK, *TWICE],  # a sign that is known
    ):
        assert verdict(SLOW, "3.9", *nodes) is Outcome.MALFORMED
    assert verdict(task(["1"], ["1", "0"]), "0.9", NONE) is Outcome.MALFORMED  # no limits of pulses
    assert verdict({**SLOW, "initial_state": ["0"]}, "3.9", *TREES) is Outcome.MALFORMED


def test_trees_are_of_so_many_pulses_and_the_work_on_them_is_counted() -> None:
    fine, many = (task(["1"], ["1", "0"], pulses=n) for n in (200, 201))
    assert verdict(fine, "0.9", end(1, widths=[0] * 200)) is Outcome.PROVED
    assert verdict(many, "0.9", end(1, widths=[0] * 201)) is Outcome.MALFORMED
    with posed(fine) as own:
        box, one = pulses.whole(200, fmpq(1), own), shaped(leaf(1, widths=[0] * 200), LEAF, "leaf")
        spread = tuple(pulses.Range((fmpq(4 * i), fmpq(4 * i + 1)), (fmpq(4 * i + 2), fmpq(4 * i + 3)), 1) for i, _ in enumerate(box))
        for part, least in ((box, 1e3), (spread, 4e5)):  # a look at each pulse on each piece: 0.4 s of them
            work["left"] = 1e9
            pulses.refuted(own, part, one, fmpq(800), lower.support)
            assert 1e9 - work["left"] > least
        work["left"] = 1e5
        with pytest.raises(Undecided):
            pulses.refuted(own, spread, one, fmpq(800), lower.support)
        work["left"] = 1e4
        with pytest.raises(Undecided, match="more work"):  # parts that are gone count, too
            pulses.prove(own, [shaped(node, PULSES[0], "node") for node in [split(0, "begin", "-1")] * 300], fmpq(1), lower.support)


# A double integrator: p = a + b s, whose integrals are fractions.


def exactly(x: Fraction) -> fmpq:
    return fmpq(x.numerator, x.denominator)


def most(
    edges: list[Four],
    signs: list[int],
    p: tuple[Fraction, Fraction],
    prices: list[Fraction],
    fuel: Fraction,
    limits: tuple[Fraction, Fraction],
    time: Fraction,
) -> Fraction:
    """∫_0^time max over what is admitted, exactly: by its definition, at the middle of intervals on which nothing changes."""
    own = [
        [(u * p[1], u * p[0] + price - fuel * abs(u)) for u in limits if u * sign > 0 or (sign == 0 and u)]
        for sign, price in zip(signs, prices, strict=True)
    ]
    lines = [(F(0), F(0)), *(line for some in own for line in some)]
    places = {F(0), time, *(x for four in edges for x in four)}
    places |= {(d - b) / (a - c) for a, b in lines for c, d in lines if a != c}
    total = F(0)
    for begin, after in pairwise(sorted(x for x in places if 0 <= x <= time)):
        s = (begin + after) / 2
        sure = [some for some, (_, b, c, _) in zip(own, edges, strict=True) if b < s < c]
        may = [line for some, (a, _, _, d) in zip(own, edges, strict=True) if a < s < d for line in some]
        total += max(m * s + k for m, k in (sure[0] if sure else [(F(0), F(0)), *may])) * (after - begin)
    return total


def random_part(rng: random.Random) -> tuple[list[Four], list[int]]:
    """One to three pulses in order, their edges in ranges that may be points, or meet."""
    count = rng.randint(1, 3)
    at = sorted(F(rng.randint(0, 20), 4) for _ in range(4 * count))
    edges: list[Four] = []
    for i in range(count):
        a, b, c, d = at[4 * i : 4 * i + 4]
        match rng.randrange(4):
            case 0:
                b = a
            case 1:
                b, c = c, b
            case 2:
                c = d
            case _:
                pass
        edges.append((a, b, c, d))
    return edges, [rng.choice((-1, 0, 1)) for _ in edges]


@pytest.mark.parametrize("seed", range(60))
def test_the_inequality_is_exactly_the_integral(seed: int) -> None:
    """A displacement a hair beyond what a part can do is refuted, and one a hair within is not."""
    rng = random.Random(seed)
    limits = rng.choice([(F(-1), F(1)), (F(-1), F(2)), (F(-1, 2), F(1)), (F(0), F(1)), (F(-3), F(0))])
    edges, signs = random_part(rng)
    signs = [1 if limits[0] == 0 else -1 if limits[1] == 0 else sign for sign in signs]
    p = (F(rng.choice([0, rng.randint(-9, 9)]), 3), F(rng.choice([-2, -1, 1, 2]), 3))
    prices, budget = [F(rng.choice([0, rng.randint(0, 6)]), 2) for _ in edges], rng.choice([None, F(3, 2)])
    fuel = F(rng.choice([0, 1, 3]), 4) if budget else F(0)
    time, width = F(5), F(1, 3)
    total = most(edges, signs, p, prices, fuel, limits, time)
    box = tuple(
        pulses.Range((exactly(a), exactly(b)), (exactly(c), exactly(d)), sign) for (a, b, c, d), sign in zip(edges, signs, strict=True)
    )
    for beyond in (True, False):
        hair = F(1 if beyond else -1, 10**20)
        way = (total + hair - width * sum(prices) + fuel * (budget or 0)) / p[1]
        if way == 0:
            continue
        of = task(["1"], ["1", "0", "0"], written(way), limits=tuple(map(written, limits)), pulse_width="1/3")
        of["limits"]["fuel"] = None if budget is None else written(budget)
        with posed(of) as own:
            one = shaped(leaf(*p, widths=prices, fuel=fuel), LEAF, "leaf")
            assert pulses.refuted(own, box, one, exactly(time), lower.support) is beyond


def test_pulses_may_fill_all_of_the_time_and_no_more() -> None:
    """Ranges that reach beyond the time, as balls of its end may."""
    with posed(task(["1"], ["1", "0"], "3", pulse_width="1")) as own:
        for time, beyond in ((F(3), False), (F(3) - F(1, 10**30), True), (F(10, 3), False)):
            box = (pulses.Range((fmpq(0), exactly(time)), (fmpq(0), exactly(time)), 1),)
            assert pulses.refuted(own, box, shaped(leaf(1, widths=[0]), LEAF, "leaf"), exactly(time), lower.support) is beyond


@pytest.mark.parametrize("seed", range(40))
def test_edges_that_are_no_dyadic_numbers_count_outwards(seed: int) -> None:
    """With few bits balls of the edges are wide: what is refuted is so with more bits, too."""
    rng = random.Random(seed)
    edges, signs = random_part(rng)
    edges = [(a / 3, b / 3, c / 3, d / 3) for a, b, c, d in edges]
    p, prices, time = (F(1, 7), F(rng.choice([-1, 1]), 3)), [F(rng.randint(0, 6), 7) for _ in edges], F(5, 3)
    total = most(edges, signs, p, prices, F(0), (F(-1), F(1)), time)
    box = tuple(
        pulses.Range((exactly(a), exactly(b)), (exactly(c), exactly(d)), sign) for (a, b, c, d), sign in zip(edges, signs, strict=True)
    )
    for hair, beyond in ((F(-1, 10**15), False), (F(0), False), (F(1, 100), True)):
        way = (total + hair - F(1, 3) * sum(prices)) / p[1]
        with posed(task(["1"], ["1", "0", "0"], written(way), pulse_width="1/3"), 40) as own:
            one = shaped(leaf(*p, widths=prices), LEAF, "leaf")
            assert pulses.refuted(own, box, one, exactly(time), lower.support) is beyond


SHIFTED = [(F(k), F(k), F(3 * k + 1, 3), F(3 * k + 1, 3)) for k in (0, 1, 2)]  # the edges of three pulses of 1/3 s
EARLIER = [(F(3 * k + 2, 3), F(3 * k + 2, 3), F(k + 1), F(k + 1)) for k in (0, 1, 2)]
OPEN = [(a, d, a, d) for a, _, _, d in SHIFTED]  # nowhere certain


@pytest.mark.parametrize("edges", [SHIFTED, EARLIER, OPEN, [(a, d, a, d) for a, _, _, d in EARLIER]])
@pytest.mark.parametrize(("bits", "late"), [(30, 0), (53, 0), (30, 2**12), (40, 2**20)])
def test_edges_in_balls_never_add_up_to_less(edges: list[Four], bits: int, late: int) -> None:
    """Three thirds are 1: what is admitted is at least that long, and what is certain at most; late instants have wide balls."""
    edges = [(a + late, b + late, c + late, d + late) for a, b, c, d in edges]
    box = tuple(pulses.Range((exactly(a), exactly(b)), (exactly(c), exactly(d)), 1) for a, b, c, d in edges)
    for side, sure in ((1, False), (-1, True)):
        if sure and edges[0][1] > edges[0][2]:
            continue
        for hair, beyond in ((F(0), False), (F(1, 2**10), True)):
            way = F(1) + side * hair
            with posed(task(["1"], ["1", "0"], written(way), pulse_width="1/3"), bits) as own:
                one = shaped(leaf(side, widths=[0, 0, 0]), LEAF, "leaf")
                assert pulses.refuted(own, box, one, fmpq(4 + late), lower.support) is beyond


@pytest.mark.parametrize("bits", [24, 30, 40, 53, 60])
def test_the_end_of_the_time_is_not_cut_off(bits: int) -> None:
    """1/3 s at the beginning, 2/3 s at the end of 1 + 2/3 s."""
    box = tuple(pulses.Range((exactly(a), exactly(b)), (exactly(a), exactly(b)), 1) for a, b in ((F(0), F(1, 3)), (F(1), F(5, 3))))
    for way, beyond in ((F(1), False), (1 + F(1, 2**16), True)):
        with posed(task(["1"], ["1", "0"], written(way), pulse_width="1/3"), bits) as own:
            one = shaped(leaf(1, widths=[0, 0]), LEAF, "leaf")
            assert pulses.refuted(own, box, one, fmpq(5, 3), lower.support) is beyond


# Trees that are grown at random, and what a liar makes of them.


def grown(rng: random.Random) -> list[dict[str, Any]]:
    """The nodes of `TREES` with parts that are split once more, or twice, each half refuted for the reason of the whole."""

    def more(node: dict[str, Any]) -> list[dict[str, Any]]:
        widths = node["leaf"]["widths"] if node["leaf"] else ()
        if not widths or rng.random() < 0.6:
            return [copy.deepcopy(node)]
        edge, at = rng.choice(["begin", "end"]), written(F(rng.randint(-1, 17), 4))
        return [split(rng.randrange(len(widths)), edge, at), *more(node), *more(node)]

    return [one for node in TREES for one in more(node)]


@pytest.mark.parametrize("seed", range(20))
def test_no_changed_tree_proves_more_than_the_truth(seed: int) -> None:
    """Splits, prices and costates are changed at random; 4 s is the minimum time."""
    rng = random.Random(seed)
    nodes = grown(rng)
    assert verdict(SLOW, "3.999999999", *nodes) is Outcome.PROVED
    for _ in range(rng.randint(0, 3)):
        node, other = rng.choice(nodes), rng.choice([node for node in nodes if node["leaf"]])["leaf"]
        if node["split"]:
            node["split"].update(at=written(F(rng.randint(-2, 30), 5)), edge=rng.choice(["begin", "end", "sign"]), pulse=rng.randint(0, 2))
        elif rng.random() < 0.5:
            nodes.remove(node)
        else:
            node["leaf"].update(costate=other["costate"], widths=[written(number(w) * rng.randint(0, 3)) for w in node["leaf"]["widths"]])
    assert verdict(SLOW, "4.000000001", *nodes) is not Outcome.PROVED
