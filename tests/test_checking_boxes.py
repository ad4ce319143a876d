"""Robust tasks as a liar would write them: poles that come and go, that hide behind each other, or that cost too much to look at."""

from __future__ import annotations

from typing import Any

import pytest
from flint import acb, fmpq
from forgery import certificate, command, costate, task

from relaxations.checking import balls, boxes, lower
from relaxations.checking.claims import Check, Outcome, check, claim
from relaxations.checking.families import family
from relaxations.checking.reading import Undecided, read

Terms = list[list[Any]]


def terms(*pairs: tuple[str, int]) -> Terms:
    """A polynomial in one parameter: (coefficient, power)."""
    return [[coefficient, [power]] for coefficient, power in pairs]


def constant(coefficients: list[str]) -> list[Terms]:
    """Coefficients that depend on no parameter."""
    return [terms((c, 0)) if c != "0" else [] for c in coefficients]


def boxed(denominator: list[str], members: list[Terms], ranges: tuple[str, str, str], tolerance: str, **others: Any) -> dict[str, Any]:
    """A robust task for a plant 1/D with one parameter: (nominal, low, high)."""
    of = task(["1"], denominator, **others)
    parameter = dict(zip(("name", "nominal", "low", "high"), ("k", *ranges), strict=True))
    form = {"numerator": constant(["1"]), "denominator": members, "outputs": {}, "plants": []}
    return {**of, "box": {"parameters": [parameter], **form, "tolerance": tolerance, "final_tolerance": None}}


def held(level: str, time: str = "20", free: bool = False) -> tuple[None, dict[str, Any]]:
    """A witness of the upper side: one level."""
    return None, command(time, [("0", level)], [["time", 0, 0]] if free else [])


def lower_witness(places: list[str]) -> tuple[dict[str, Any], None]:
    """A witness of the lower side that looks at plants at these places."""
    contact = {"time": "1", "upper": "1", "lower": "0"}
    samples = [{"place": [place], "residual": [contact], "deflection": [], "after": []} for place in places]
    return {**costate(), "samples": samples}, None


def found(of: dict[str, Any], upper: str, witnesses: tuple[Any, Any]) -> Check:
    return check(certificate(of, upper=upper, witnesses=witnesses))


@pytest.mark.parametrize("width", ["0.01", "0.1"])
def test_an_integrator_of_the_nominal_plant_alone(width: str) -> None:
    """(s + k²)(s² + s + 1): for k ≠ 0 the output creeps back from where the command leaves it, by all of the displacement."""
    members = [terms(("1", 0)), terms(("1", 0), ("1", 2)), terms(("1", 0), ("1", 2)), terms(("1", 2))]
    of = boxed(["1", "1", "1", "0"], members, ("0", f"-{width}", width), "0.1")
    assert found(of, "20.1", held("0.05", free=True)).outcome is not Outcome.PROVED
    # Must be proven: the same without the parameter.
    alone = boxed(["1", "1", "1", "0"], constant(["1", "1", "1", "0"]), ("0", f"-{width}", width), "0.1")
    assert found(alone, "20.1", held("0.05", free=True)).outcome is Outcome.PROVED


@pytest.mark.parametrize("apart", ["0.0001", "0.01", "1"])
def test_unstable_poles_beside_one_on_the_axis(apart: str) -> None:
    """In w = s²: a real root, and a pair with nearly the same real part, which is ± a ± j b in s. Every plant of the box is unstable."""
    whole = {"0.0001": ["6.3", "13.2301", "9.261213"], "0.01": ["6.3", "13.24", "9.282003"], "1": ["6.3", "14.23", "11.361003"]}[apart]
    denominator = ["1", "0", whole[0], "0", whole[1], "0", whole[2]]
    of = boxed(denominator, constant(denominator), ("1", "1", "1"), "1000000000000", limits=("-30", "30"))
    assert found(of, "1", held(whole[2], "1")).outcome is not Outcome.PROVED


def test_an_undamped_plant_with_exact_poles() -> None:
    """1/(s² + 1) after one period at the final input: at rest, whatever the tolerance; after half a period it swings by twice the move."""
    of = boxed(["1", "0", "1"], constant(["1", "0", "1"]), ("1", "1", "1"), "1.01")
    assert found(of, "1", held("1", "1")).outcome is Outcome.PROVED  # starting at once swings by the displacement
    tight = boxed(["1", "0", "1"], constant(["1", "0", "1"]), ("1", "1", "1"), "0.99")
    assert found(tight, "1", held("1", "1")).outcome is not Outcome.PROVED


def test_a_name_cannot_widen_the_box() -> None:
    """The claim is read by people: what a parameter is called must not look like a range."""
    of = boxed(["1", "0", "1"], constant(["1", "0", "1"]), ("1", "1", "1"), "1.01")
    of["box"]["parameters"][0]["name"] = "m in [0.7, 1.3] (nominal 1), k"
    words = claim(found(of, "1", held("1", "1")))
    assert "'m in [0.7, 1.3] (nominal 1), k' in [1, 1] (nominal 1)" in words


def test_the_words_of_a_robust_task_promise_no_rest() -> None:
    of = boxed(["1", "0", "1"], constant(["1", "0", "1"]), ("1", "1", "1"), "1.01")
    words = claim(found(of, "1", held("1", "1")))
    assert "stays at rest" not in words
    assert "residual |y(t) - y(∞)| for t ≥ T is at most 1.01 of the displacement" in words


def listed(nominal: dict[str, list[str]], other: dict[str, list[str]], final: str) -> dict[str, Any]:
    """A robust task about two plants."""
    of = task(nominal["numerator"], nominal["denominator"], limits=("-5", "5"))
    plants = [{"place": ["0"], "outputs": {}, **nominal}, {"place": ["1"], "outputs": {}, **other}]
    form = {"numerator": [], "denominator": [], "outputs": {}, "plants": plants}
    parameter = {"name": "k", "nominal": "0", "low": "0", "high": "1"}
    return {**of, "box": {"parameters": [parameter], **form, "tolerance": "5", "final_tolerance": final}}


def test_no_task_is_impossible_for_a_final_error_that_it_has_not() -> None:
    """By its lowest coefficients: those of the same gain with other signs, and those of a plant without the nominal one's integrator."""
    witness = lower_witness(["1"])

    def impossible(of: dict[str, Any]) -> Outcome:
        return check(certificate(of, impossible="final", witnesses=witness)).outcome

    nominal, cart = {"numerator": ["1"], "denominator": ["1", "1"]}, {"numerator": ["1"], "denominator": ["1", "1", "0"]}
    assert impossible(listed(nominal, {"numerator": ["-1"], "denominator": ["1", "-1"]}, "0.1")) is not Outcome.PROVED
    assert impossible(listed(cart, {"numerator": ["1"], "denominator": ["1", "0.1", "0.1"]}, "2")) is not Outcome.PROVED
    # Must be proven: twice the gain, and a tenth of the drag.
    assert impossible(listed(nominal, {"numerator": ["2"], "denominator": ["1", "1"]}, "0.1")) is Outcome.PROVED
    assert impossible(listed(cart, {"numerator": ["1"], "denominator": ["1", "0.1", "0"]}, "2")) is Outcome.PROVED


LONG = "1." + "3" * 1990


@pytest.mark.slow
def test_hostile_boxes_are_given_up() -> None:
    """Sixty-fourth powers of a number of 2,000 digits, in a thousand terms; a thousand plants of fifty poles; plants with long numbers."""
    sums = terms(*[("1", 64)] * 200, *[("-1", 64)] * 200, ("1", 0))
    of = boxed(["1"] * 6, [terms(("1", 0)), *[sums] * 5], (LONG, "1", "2"), "0.1")
    assert check(certificate(of, lower="1", witnesses=lower_witness([]))).outcome is Outcome.INCONCLUSIVE
    many = ["1", *["0"] * 49, "1"]
    members = [*constant(many[:-1]), terms(("1", 1))]
    of = boxed(many, members, ("1", "0.5", "1.5"), "0.1")
    places = [f"1.{i:03d}1" for i in range(100)]
    assert check(certificate(of, lower="1", witnesses=lower_witness(places))).outcome is not Outcome.PROVED
    assert check(certificate(of, lower="1", witnesses=lower_witness([LONG] * 10))).outcome is not Outcome.PROVED


@pytest.mark.parametrize(("name", "fine"), [("k", True), ("k" * 80, True), ("", False), ("k" * 81, False), ("k\n", False), (1, False)])
def test_names_of_parameters(name: Any, fine: bool) -> None:
    of = boxed(["1", "0", "1"], constant(["1", "0", "1"]), ("1", "1", "1"), "1.01")
    of["box"]["parameters"][0]["name"] = name
    assert found(of, "1", held("1", "1")).outcome is (Outcome.PROVED if fine else Outcome.MALFORMED)


def moving(denominator: list[str], *parameters: tuple[str, str | None, str, str], numerator: tuple[str, ...] = ("1",)) -> dict[str, Any]:
    """A robust task whose parameters move roots: name, nominal value, ends."""
    of = task(list(numerator), denominator, limits=("-5", "5"))
    written = [dict(zip(("name", "nominal", "low", "high"), p, strict=True)) for p in parameters]
    box = {
        "parameters": written,
        "numerator": [],
        "denominator": [],
        "outputs": {},
        "plants": [],
        "tolerance": "1.01",
        "final_tolerance": None,
    }
    return {**of, "box": box}


def test_roots_that_move_onto_each_other() -> None:
    """Two modes that meet inside the box have no motions there: nothing is proven, and nothing raised."""
    apart = ["1", "0", "5", "0", "4"]  # 1 and 2 rad/s
    wide = moving(apart, ("mode[1].frequency", "1", "0.9", "2.5"))
    assert found(wide, "1", held("4", "1")).outcome is Outcome.INCONCLUSIVE
    still = moving(apart, ("mode[1].frequency", "1", "1", "1"))
    still["box"]["tolerance"] = "2.01"  # begun at once: at most the sizes of both motions, 4/3 and 1/3
    assert found(still, "1", held("4", "1")).outcome is Outcome.PROVED


def test_hostile_moves() -> None:
    """Ends that are next to nothing or long, roots on top of each other, and more modes than one would move: an answer, in seconds."""
    tiny = "1/" + "1" + "0" * 300
    for box in (
        moving(["1", "0", "1"], ("mode[1].frequency", "1", tiny, "1")),
        moving(["1", "0.2", "1"], ("mode[1].damping", None, "0", "0.999999999999999999999999999999999999999999999999999")),
        moving(["1", "0.2", "1"], ("mode[1].damping", None, tiny, LONG.replace("1.", "0."))),
        moving(["1", "3", "2"], ("zero[1]", "1", tiny, "1" + "0" * 300), numerator=("1", "2")),
        moving(["1", "0", "2", "0", "1"], ("mode[1].frequency", "1", "0.9", "1.1")),  # a repeated mode
        moving(["1", "0", "1"], ("mode[1].frequency", "1", "1", "1"), ("mode[1].damping", None, "0", "0")),
        moving(["1", *["0"] * 39, "1"], *((f"mode[{i}].damping", None, "0.1", "0.2") for i in range(1, 9))),
    ):
        box["box"]["tolerance"] = "0.9"  # what holds at once leaves 1, and twice of it more
        for upper in (held("1", "1"), held("2", "20")):
            checked = found(box, "20", upper)
            assert checked.seconds < 100.0
            assert checked.outcome is not Outcome.PROVED
        assert check(certificate(box, lower="1", witnesses=lower_witness(["1"]))).outcome is not Outcome.PROVED


def limited(nominal: str, ends: tuple[str, str], gain: str, denominator: list[Terms], written: list[str]) -> dict[str, Any]:
    """A robust task about gain/D with one parameter, its speed limited to 1/5."""
    of = task([gain], written, deflection={"v": "1/5"}, outputs={"v": [gain, "0"]})
    parameter = {"name": "k", "nominal": nominal, "low": ends[0], "high": ends[1]}
    form = {"numerator": constant([gain]), "denominator": denominator, "outputs": {"v": constant([gain, "0"])}, "plants": []}
    return {**of, "box": {"parameters": [parameter], **form, "tolerance": "100", "final_tolerance": None}}


def test_outputs_of_a_box_move_with_all_poles_of_its_plants() -> None:
    """A body and a slow mode: what the nominal plant's output does without its mode is no bound (5/2 s are enough, 4.9 were claimed)."""
    of = limited("1", ("1", "1"), "1/100", constant(["1", "0", "1/100", "0", "0"]), ["1", "0", "1/100", "0", "0"])
    press = {"output": "v", "begin": "0", "end": "49/10", "weight": "49/10"}
    lie = costate((("0", "0"), [("0", "0"), ("1", "0")]), deflection=[press])
    assert check(certificate(of, lower="49/10", witnesses=(lie, None))).outcome is Outcome.MALFORMED
    fixed = command("5/2", [("0", "16/25"), ("5/4", "-16/25")], [["level", 0, 0], ["level", 1, 0]])
    assert found(of, "5/2", (None, fixed)).outcome is Outcome.PROVED
    free = command("2", [("0", "1"), ("1", "-1")], [["time", 0, 0], ["start", 1, 0]])
    assert found(of, "21/10", (None, free)).outcome is Outcome.PROVED


def test_a_sample_with_fewer_poles_at_the_origin_has_no_response_there() -> None:
    """1/s² and 1/(s² + k): the second one's speed swings about 0, and does not go on."""
    of = limited("0", ("0", "1"), "1", [terms(("1", 0)), [], terms(("1", 1))], ["1", "0", "0"])
    posed = read(certificate(of, lower="1", witnesses=(costate(), None))).task
    balls.work["left"] = 1e9
    one = boxes.sample(family(posed), [fmpq(1)])
    roots = (balls.Root(acb(0), 4), *(root for root in one.roots if not root.value.is_zero()))
    with pytest.raises(Undecided, match="fewer poles at the origin"):
        one.answer(roots, "v", 0)


def test_multipliers_of_samples_come_from_the_certificate(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    relaxed = boxes.relaxed
    monkeypatch.setattr(lower.boxes, "relaxed", lambda *of: seen.append(of) or relaxed(*of))
    of = boxed(["1", "0.2", "1"], [*constant(["1", "0.2"]), terms(("1", 1))], ("1", "0.9", "1.1"), "0.01", limits=("-5", "5"))
    contact = {"time": "1", "upper": "0.25", "lower": "0"}
    sample = {"place": ["1.1"], "residual": [contact], "deflection": [], "after": []}
    check(certificate(of, lower="0.001", witnesses=({**costate(), "samples": [sample]}, None)))
    assert seen
    for posed, samples in seen:
        assert posed.task.box is not None
        assert [one.place for one in samples] == [(fmpq(11, 10),)]
