"""What a certificate must not say beside its numbers: outputs that rest or begin beyond limits, samples, pulses, forms that are held."""

from __future__ import annotations

from typing import Any

import pytest
from flint import arb, fmpq
from forgery import certificate, command, costate, system, task
from test_checking_boxes import constant, limited

from relaxations.checking import balls, changes, lower
from relaxations.checking.claims import Check, Outcome, check
from relaxations.checking.reading import PAIR, Malformed, Refuted, Undecided, shaped

pytestmark = pytest.mark.usefixtures("enough_work")


def found(of: dict[str, Any], *chains: Any, **others: Any) -> Check:
    return check(certificate(of, "1", witnesses=(costate(*(chains or ((("0", "0"), [("1", "0")]),)), **others), None)))


def malformed(of: dict[str, Any], **others: Any) -> bool:
    return found(of, **others).outcome is Outcome.MALFORMED


@pytest.mark.parametrize(("gain", "rest"), [("4", "1/4"), ("1/4", "4"), ("-1/4", "4"), ("1", "1")])
def test_an_output_may_rest_on_its_limit_but_not_beyond(gain: str, rest: str) -> None:
    """After a move by 1 the output 1/D of the plant k/D rests at 1/k."""

    def beyond(limit: str) -> bool:
        return malformed(task([gain], ["1", "1", "0"], outputs={"w": ["1"]}, deflection={"w": limit}))

    at = fmpq(*map(int, f"{rest}/1".split("/")[:2]))
    assert not beyond(rest)
    assert not beyond(str(at * fmpq(1001, 1000)))
    assert beyond(str(at * fmpq(999, 1000)))


@pytest.mark.parametrize("side", ["", "-"])
def test_an_output_may_begin_on_its_limit_but_not_beyond(side: str) -> None:
    """A speed of 1/2; a place that is 0, whatever its speed."""

    def beyond(limit: str, output: list[str]) -> bool:
        start = ["0", f"{side}1/2"]
        return malformed(task(["1"], ["1", "0", "0"], "1/10", initial_state=start, outputs={"w": output}, deflection={"w": limit}))

    assert not beyond("1/2", ["1", "0"])
    assert beyond("499/1000", ["1", "0"])
    assert not beyond("1/3", ["1"])


def test_a_pair_is_an_array_of_two() -> None:
    assert shaped(["0", "1"], PAIR, "here") == (0, 1)
    for data in ("01", ["0"], ["0", "1", "2"], {"0": "1", "1": "0"}, None, 2):
        with pytest.raises(Malformed, match="here is an array of 2 items"):
            shaped(data, PAIR, "here")


def test_pulses_have_widths_and_numbers_and_tasks_that_suit_them() -> None:
    for width, number, fine in (
        ("1", None, True),
        (None, 1, True),
        ("1/2", 2, True),
        ("0", None, False),
        ("0", 1, False),
        ("-1", None, False),
        ("-1", 2, False),
        (None, 0, False),
        ("1", 0, False),
    ):
        assert malformed(task(["1"], ["1", "0", "0"], pulse_width=width, pulses=number)) != fine, (width, number)
    pulses: tuple[dict[str, Any], ...] = ({"pulse_width": "1"}, {"pulses": 1})
    for one in pulses:
        assert malformed(task(["1"], ["1", "0", "0"], sample_time="1/10", **one))
        assert malformed(task(["1", "1"], ["1", "0", "0"], rest="output", **one))
    assert not malformed(task(["1"], ["1", "0", "0"], sample_time="1/10"))


# The cart in a box of its own: speed at most 1/5.
CART = limited("1", ("1", "1"), "1", constant(["1", "1", "0"]), ["1", "1", "0"])
PRESS = {"output": "v", "begin": "0", "end": "1/2", "weight": "1"}
AFTER = {"output": "v", "time": "1", "upper": "1", "lower": "0"}
CHAINS = ((("0", "0"), [("1", "0")]), (("-1", "0"), [("-1", "0")]))


def sampled(of: Any = CART, time: str = "1", **changes: Any) -> Check:
    sample = {"place": ["1"], "residual": [], "deflection": [], "after": [], **changes}
    return check(certificate(of, time, witnesses=({**costate(CHAINS[0]), "samples": [sample]}, None)))


@pytest.mark.parametrize(
    ("change", "fine"),
    [
        ({"deflection": [PRESS]}, True),
        ({"deflection": [{**PRESS, "output": "w"}]}, False),
        ({"deflection": [{**PRESS, "begin": "-1"}]}, False),
        ({"deflection": [{**PRESS, "begin": "2"}]}, False),
        ({"after": [AFTER]}, True),
        ({"after": [{**AFTER, "time": "0", "upper": "0"}]}, True),
        ({"after": [{**AFTER, "output": None}]}, False),
        ({"after": [{**AFTER, "output": "w"}]}, False),
        ({"after": [{**AFTER, "time": "-1"}]}, False),
        ({"after": [{**AFTER, "upper": "-1"}]}, False),
        ({"after": [{**AFTER, "lower": "-1"}]}, False),
        ({"residual": [{"time": "1", "upper": "-1", "lower": "0"}]}, False),
        ({"residual": [{"time": "1", "upper": "1", "lower": "-1"}]}, False),
        ({"residual": [{"time": "-1", "upper": "1", "lower": "0"}]}, False),
    ],
)
def test_multipliers_of_samples_are_of_limits_and_not_negative(change: dict[str, Any], fine: bool) -> None:
    assert (sampled(**change).outcome is not Outcome.MALFORMED) == fine


def test_multipliers_of_a_slope_are_not_those_of_samples() -> None:
    sloped = {**CART, "limits": {**CART["limits"], "rate": ["-4", "4"]}}
    assert sampled(sloped, after=[{**AFTER, "output": None}]).outcome is Outcome.MALFORMED


def test_many_samples_go_without_multipliers_of_outputs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lower, "MOST_CELLS", 5)
    alone = task(["1"], ["1", "1", "0"], sample_time="1/10", outputs={"v": ["1", "0"]}, deflection={"v": "1/5"})
    for witness in (costate(*CHAINS, deflection=[PRESS]), costate(*CHAINS)):
        reason = check(certificate(alone, "1", witnesses=(witness, None))).reason
        assert ("more samples than" in reason) == bool(witness["deflection"])
    boxed = {**CART, "limits": {**CART["limits"], "sample_time": "1/10"}}
    assert "more samples than" in sampled(boxed, deflection=[PRESS]).reason


def test_a_right_side_that_may_be_negative_refutes_nothing_by_itself() -> None:
    """Where nothing is asked of the costate both sides are 0: false for an input in limits, undecided with multipliers of its slope."""
    nothing = (("0", "0"), [("0", "0"), ("0", "0")])
    posed = task(["1"], ["1", "0", "0"], rate=["-4", "4"])
    assert found(task(["1"], ["1", "0", "0"]), nothing).outcome is Outcome.REFUTED
    assert found(posed, nothing, ramps=[{"edges": ["0", "1"], "levels": ["0"]}]).outcome is not Outcome.REFUTED


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"rest": "output"}, "a box belongs to a state rest without further zeros"),
        ({"plants": [{**CART["plants"][0], "zeros": {"real[1]": 1}}]}, "a box belongs to a state rest without further zeros"),
        ({"box": {**CART["box"], "outputs": {"v": []}}}, "outputs of a box are strictly proper"),
        ({"box": {**CART["box"], "outputs": {"v": constant(["1", "0", "0", "0"])}}}, "outputs of a box are strictly proper"),
        ({"box": {**CART["box"], "outputs": {}}}, "the outputs written of a box are those whose deflection is limited"),
    ],
)
def test_what_goes_with_a_box(change: dict[str, Any], said: str) -> None:
    outcome = sampled({**CART, **change})
    assert outcome.outcome is Outcome.MALFORMED
    assert said in outcome.reason


@pytest.mark.parametrize(
    ("ramps", "steps", "fine"),
    [
        ([["0", "1"]], ["1"], True),
        ([["0", "1"]], [], True),
        ([["1/2", "1"]], ["1"], False),
        ([["0", "1"]], ["1", "1"], False),
        ([], ["1"], False),
        ([["0", "1", "2"], ["2", "3"]], [], True),
        ([["0", "1", "2"], ["3/2", "3"]], [], False),
        ([["0", "2", "1"]], [], False),
    ],
)
def test_ramps_are_disjoint_and_begin_with_one_number_at_0(ramps: list[list[str]], steps: list[str], fine: bool) -> None:
    posed = task(["1"], ["1", "0", "0"], rate=["-4", "4"])
    made = [{"edges": edges, "levels": ["0"] * (len(edges) - 1)} for edges in ramps]
    assert malformed(posed, ramps=made, steps=steps) != fine


# Inputs one way, then the other.


def held(first: str = "positive, then negative", **others: Any) -> dict[str, Any]:
    return task(["1"], ["1", "0", "0"], held=first, **others)


def node(at: str, coefficients: tuple[str, str] = ("-1", "1"), fuel: str = "0") -> dict[str, Any]:
    """p = c_0 + c_1 s, s the time to go."""
    chain = {"near": ["0", "0"], "coefficients": [[c, "0"] for c in coefficients]}
    return {"at": at, "costate": [[chain]], "fuel": fuel}


def cover(*nodes: Any, time: str = "1", **others: Any) -> Check:
    return check(certificate(held(**others), time, witnesses=(costate((("0", "0"), [("0", "0")]), changes=nodes), None)))


@pytest.mark.parametrize(
    ("of", "nodes", "fine"),
    [
        (held(), [node("0"), node("1")], True),
        (held(), [node("0"), node("1"), node("1")], True),
        (held(), [node("1/2"), node("1")], False),
        (held(), [node("0"), node("1"), node("1/2")], False),
        (task(["1"], ["1", "0", "0"]), [node("0"), node("1")], False),
        (held(), [node("0"), node("1", fuel="1")], False),
        (held(fuel="9"), [node("0"), node("1", fuel="1")], True),
        (held(fuel="9"), [node("0"), node("1", fuel="-1")], False),
        (held(sample_time="1/10"), [], False),
        (held(rate=["-4", "4"]), [], False),
        (held(initial_state=["0", "1"]), [], False),
        (held(outputs={"v": ["1", "0"]}, deflection={"v": "1"}), [], False),
        (task(["1", "1"], ["1", "0", "0"], rest="output", held="negative, then positive"), [], False),
    ],
)
def test_nodes_belong_to_a_form_that_is_held(of: dict[str, Any], nodes: list[Any], fine: bool) -> None:
    assert malformed(of, changes=nodes) != fine


def test_levels_of_a_form() -> None:
    """Deviations in order of time; 0 is of either side."""
    for first, along in (("positive, then negative", 1), ("negative, then positive", -1)):
        posed = system(held(first))

        def outcome(levels: list[Any], posed: Any = posed, along: int = along) -> str:
            try:
                changes.form(posed, [along * level for level in levels])
            except (Refuted, Undecided) as problem:
                return f"{type(problem).__name__}: {problem}"
            return ""

        one = fmpq(1)
        for levels in ([], [one], [-one], [one, -one], [one, one, -one, -one], [one, 0 * one, -one, 0 * one, -one], [0 * one, one]):
            assert outcome(levels) == ""
        assert outcome([one, -one, one]) == "Refuted: level 2 is along the first direction after the sign has changed"
        assert outcome([-one, 0 * one, one]).startswith("Refuted: level 2")
        assert outcome([one, arb(0, 1), -one]).startswith("Undecided: the sign of level 1")
        assert outcome([one, -one, arb(0, 1)]).startswith("Undecided: the sign of level 2")
        assert outcome([arb(2, 1), arb(-2, 1)]) == ""
        assert outcome([arb(-2, 1), arb(2, 1)]).startswith("Refuted: level 1")


def test_a_cover_of_the_cart() -> None:
    """The fastest command of the cart is of the form, and takes 2 s: p = s - T/2 at every node."""
    nodes = [node(f"{k}/10" if k % 10 else str(k // 10), ("-1", "1")) for k in (0, 5, 9, 10, 11, 15, 20)]
    nodes = [{**one, "at": {"5/10": "1/2", "15/10": "3/2"}.get(one["at"], one["at"])} for one in nodes]
    assert cover(*nodes, time="19/10").outcome is Outcome.PROVED
    assert cover(*nodes, time="201/100").outcome is not Outcome.PROVED
    assert cover(*nodes[:-1], time="19/10").outcome is not Outcome.PROVED  # the last change is not covered
    assert cover(*nodes, time="19/10", first="negative, then positive").outcome is Outcome.PROVED  # no such command reaches the target
    assert cover(*nodes, time="19/10", limits=("-1", "13/10")).outcome is not Outcome.PROVED
    assert cover(*nodes, time="19/10", limits=("-13/10", "1")).outcome is not Outcome.PROVED
    assert cover(*nodes, time="19/10", displacement="9/10").outcome is not Outcome.PROVED


def test_what_a_node_pays() -> None:
    """`limit ∫ max(0, s - 1 - price) ds`, from a to b."""
    wave = balls.Wave.of(system(held()).roots, [arb(-1), arb(1)])
    for price, low, high, expected in ((0, 0, 3, 2.0), (0, 2, 3, 1.5), (1, 0, 3, 0.5), (0, 3, 3, 0.0), (0, 0, 1, 0.0), (0, 3, 2, 0.0)):
        paid = changes.pay(wave, fmpq(price), arb(3), (arb(low), arb(high)), lower.support, arb(2) ** -100)
        assert float(paid) == pytest.approx(3 * expected, abs=1e-20)
    paid = changes.pay(wave.reversed(), fmpq(1, 2), arb(2), (arb(0), arb(1)), lower.support, arb(2) ** -100)
    assert float(paid) == pytest.approx(2 / 8, abs=1e-20)


def test_what_lies_between_two_nodes() -> None:
    """For p = s - c: both at one side, and where p changes its sign, which for -p falls."""
    roots = system(held()).roots

    def excess(first: tuple[float, float], other: tuple[float, float], a: float, b: float, price: int = 0) -> float:
        waves = [balls.Wave.of(roots, [arb(x) for x in pair]) for pair in (first, other)]
        return float(changes.between(waves, (fmpq(price), fmpq(price)), arb(a), arb(b), arb(2), arb(3)))

    assert excess((0, 1), (0, 1), 1, 2) == pytest.approx(2 * (2 - 1) / 4)
    assert excess((0, 1), (1, 0), 1, 2) == pytest.approx(0, abs=1e-8)
    assert excess((0, -1), (0, -1), 1, 2) == pytest.approx(3 * (2 - 1) / 4)
    assert excess((1, 0), (0, 1), 1, 2, price=1) == pytest.approx(2 / 4)
    assert excess((-1.5, 1), (-1.5, 1), 1, 2) == pytest.approx(2 * 0.5 + 3 * 0.5)
    first, other = (1.5, -1.0), (1.25, -1.0)
    assert excess(first, other, 1, 2) == pytest.approx(3 * 0.75**2 / 2)
    assert excess(first, other, 1.25, 1.5) == pytest.approx(3 * 0.25**2 / 2)


def test_a_command_of_the_form() -> None:
    """The fastest command of the cart, and its mirror image, which is of the other form."""
    for level, displacement, first, outcome in (
        ("1", "1", "positive, then negative", Outcome.PROVED),
        ("1", "1", "negative, then positive", Outcome.REFUTED),
        ("-1", "-1", "negative, then positive", Outcome.PROVED),
        ("-1", "-1", "positive, then negative", Outcome.REFUTED),
    ):
        back = level[1:] if level[0] == "-" else f"-{level}"
        witness = command("2", [("0", level), ("1", back)], [["time", 0, 0], ["start", 1, 0]])
        of = held(first) | {"displacement": displacement}
        assert check(certificate(of, upper="2000001/1000000", witnesses=(None, witness))).outcome is outcome
