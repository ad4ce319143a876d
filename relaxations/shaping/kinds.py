"""The kinds of shapers by name: which one is asked for, for which modes, and what is known of the shortest of its kind."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce

from relaxations.checking.worst import worst_residual
from relaxations.errors import ShaperError, SolverError
from relaxations.plants import exact
from relaxations.shaping.bands import Band
from relaxations.shaping.bounded import bounded, bounded_on_samples
from relaxations.shaping.comparisons import (
    ONE_MODE,
    UNPROVEN,
    bounds_of,
    compared,
    different,
    humps_of,
    least_of,
    order_of,
    own,
    ripples,
    rounded_down,
    shortest_of,
    summed,
    sums_of,
    with_negative,
    within_sums,
)
from relaxations.shaping.decayed import DECAYED
from relaxations.shaping.deflection import deflection_limited
from relaxations.shaping.drawn_out import drawn_out
from relaxations.shaping.humps import extra_insensitive, unity_magnitude
from relaxations.shaping.impulses import derivative_shaper, mzv, negative_zv
from relaxations.shaping.insensitive_samples import within_on_samples
from relaxations.shaping.least_durations import Remnant, least_with_derivatives
from relaxations.shaping.modes import Mode
from relaxations.shaping.mzv_samples import mzv_on_samples
from relaxations.shaping.negative_amplitudes import negative_at_once
from relaxations.shaping.negative_samples import negative_on_samples, within_sums_on_samples
from relaxations.shaping.promises import all_modes, all_once, between_humps, between_unity_humps
from relaxations.shaping.pulses import at_intervals, pulsed
from relaxations.shaping.ranges import humped_ranges
from relaxations.shaping.requests import Least, Made, Request
from relaxations.shaping.sampled import Sampled, sampled
from relaxations.shaping.shapers import Shaper, convolve
from relaxations.shaping.small_tolerances import least_known, within
from relaxations.shaping.sums_within import within_sums_and_bands
from relaxations.shaping.touching import least_of_positive, least_up_to_one_of
from relaxations.shaping.vanishing import require

NO_FEWER = "no least duration: that fewer samples do not do is so close that it was not proven"


@dataclass(frozen=True, slots=True)
class Kind:
    """One family: how its name is written, what it is, which further options it takes, and how it is made from (request, number).

    `zeros` says where it leaves nothing, and how many derivatives vanish there; None where other demands make it. `keeps`: the tolerance
    over the bands that are asked for.
    """

    written: str
    pattern: str
    meaning: str
    make: Callable[[Request, int], Made]
    takes: frozenset[str] = frozenset()
    needs: frozenset[str] = frozenset()
    zeros: Callable[[Request, int], tuple[tuple[Mode, ...], int]] | None = None
    keeps: bool = False
    apart: str = ""  # why there is no one solution for several modes, and what there is


OPTIONS = ("negative", "sums", "sample_time", "simultaneous", "pulse", "height", "impulses", "deflection")
"""Members of `Request` that belong to some kinds only."""


def make(name: str, request: Request) -> Made:
    """The shaper of the kind `name` ("zvd", "2-hump-ei", "um-zv" …).

    Raises `ShaperError` naming what is wrong with the request, `ImpossibleShaperError` if there is no such shaper.
    """
    kind, number = find(name)
    wrong = [f"{option}: {problem}" for option, problem in mistakes(kind, name, request)]
    if not request.modes:
        wrong.append("a shaper needs at least one mode")
    if wrong:
        raise ShaperError("; ".join(wrong))
    made = kind.make(request, number)
    made = replace(made, ranges=tuple((request.modes.index(band.mode), band) for _, band in made.ranges))
    # In closed form zeros are exact but for rounding, and for amplitudes that are too small for doubles.
    closed = kind.make is _derivatives and request.sample_time is None and not request.simultaneous
    if kind.zeros is not None and kind.zeros in (all_modes, all_once):
        if not closed:
            require(name, made.shaper, *kind.zeros(request, number))
    elif kind.zeros is not None and made.least and made.least.zeros:
        require(name, made.shaper, made.least.zeros)
    if made.least and made.least.duration > made.shaper.duration:  # the shaper's own zeros are doubles: it may end a hair too soon
        made = replace(made, least=replace(made.least, duration=made.shaper.duration))
    if request.pulse is None or not made.shaper.times:
        return made
    positive = request.sample_time is None and min(made.shaper.amplitudes) > 0.0
    kept = request.reaches() if kind.keeps else made.ranges
    return drawn_out(made, request.pulse, [band for _, band in kept] if positive else [])


def find(name: str) -> tuple[Kind, int]:
    """The kind of this name and the number in it; raises `ShaperError` listing the kinds."""
    for kind in KINDS:
        if found := re.fullmatch(kind.pattern, name):
            digits = next((group for group in found.groups() if group and group.isdigit()), None)
            return kind, int(digits) if digits is not None else len(found["d"] or "") if "d" in found.groupdict() else 1
    raise ShaperError(f"there is no shaper {name!r}; the kinds are {', '.join(kind.written for kind in KINDS)}")


def mistakes(kind: Kind, name: str, request: Request) -> list[tuple[str, str]]:
    """Options that this kind does not take, and those that it needs, each with what is wrong."""
    given = {option for option in OPTIONS if getattr(request, option) is not None and getattr(request, option) is not False}
    wrong = [
        (option, kind.apart if option == "simultaneous" and kind.apart else f"says nothing about {name}; it is for {_takers(option)}")
        for option in sorted(given - kind.takes)
    ]
    return wrong + [(option, f"is missing; {name} needs it") for option in sorted(kind.needs - given)]


def _takers(option: str) -> str:
    return ", ".join(kind.written for kind in KINDS if option in kind.takes and kind.written != "none")


def _in_turn(modes: Sequence[Mode], one: Callable[[Mode], Shaper]) -> Shaper:
    """One shaper a mode, convolved: what is left unexcited by either is left unexcited by all."""
    return reduce(convolve, map(one, modes))


def _derivatives(request: Request, number: int) -> Made:
    zeros = [(mode, number) for mode in request.modes]
    if request.sample_time is not None:
        return _on_samples(sampled(zeros, request.sample_time), request.sample_time, zeros)
    if request.simultaneous:
        return compared(None, zeros)
    return compared(_in_turn(request.modes, lambda mode: derivative_shaper(mode, number)), zeros)


def _on_samples(found: Sampled, sample_time: float, zeros: Sequence[tuple[Mode, int]]) -> Made:
    """What so many samples take at least, if that is more than any positive shaper takes."""
    proven = rounded_down(found.needed * exact(repr(sample_time)))
    what = f"positive shapers at multiples of {sample_time!r} s with {order_of(zeros)}, which need {found.needed}"
    least = least_of(proven if found.needed else None, what, [mode for mode, _ in zeros])
    if least and len(zeros) > 1 and found.needed == round(found.shaper.duration / sample_time):  # no bound of free instants is better
        return Made(found.shaper, least)
    made = compared(found.shaper, zeros)
    return made if made.least is not None and made.least.duration >= proven else replace(made, least=least)


def _each_once(request: Request) -> Request:
    """Where one solution for all modes is asked for: what it does for a mode it does for another just like it."""
    at_once = request.simultaneous or request.sample_time is not None
    return replace(request, modes=different(request.modes)) if at_once else request


def _humps(request: Request, number: int) -> Made:
    request = _each_once(request)
    if request.sample_time is not None:
        bands = humped_ranges(request.modes, request.tolerance, number)
        what = f"positive shapers within {request.tolerance:g} over the range of each mode's own {humps_of(number)}"
        return replace(_keeping_on_samples(bands, request.sample_time, what), ranges=tuple(enumerate(bands)))
    if request.simultaneous and len(request.modes) > 1:
        return _humps_at_once(request, number)
    humped = [extra_insensitive(mode, request.tolerance, number) for mode in request.modes]
    zeros = [zero for one in humped for zero in one.zeros]
    shaper = reduce(convolve, (one.shaper for one in humped))
    alone = [least_of_positive(one.zeros, one.shaper) or 0.0 for one in humped]
    lower = max(*alone, *(least_with_derivatives(zero, 0) for zero in zeros))
    if len(humped) > 1 or not alone[0]:
        with suppress(SolverError):
            lower = max(lower, shortest_of([(zero, 0) for zero in zeros])[1] or 0.0)
    return Made(
        shaper, Least(lower, f"positive shapers that share {own(humped, request.modes)}", tuple(zeros)), notes=ripples(humped, request)
    )


def _humps_at_once(request: Request, number: int) -> Made:
    """The shortest positive shaper that keeps the tolerance over the range of each mode's own humped one."""
    bands = humped_ranges(request.modes, request.tolerance, number)
    shortest = within(tuple(dict.fromkeys(bands)))
    what = f"positive shapers within {request.tolerance:g} over the range of each mode's own {humps_of(number)}"
    return Made(shortest.shaper, least_of(shortest.lower, what), tuple(enumerate(bands)), (shortest.note,) if shortest.note else ())


def _unity_humps(request: Request, number: int) -> Made:
    request = _each_once(request)
    if request.sample_time is not None:
        bands = humped_ranges(request.modes, request.tolerance, number, unity_magnitude)
        shaper, needed = within_sums_on_samples(bands, 0.0, 1.0, request.sample_time)
        what = f"partial sums in [0, 1] within {request.tolerance:g} over the range of each mode's own um-{humps_of(number)}"
        return _with_samples(shaper, needed, f"sequences of {what}", request.sample_time, tuple(enumerate(bands)))
    if request.simultaneous and len(request.modes) > 1:
        bands = humped_ranges(request.modes, request.tolerance, number, unity_magnitude)
        found = within_sums_and_bands(bands, 0.0, 1.0)
        what = f"partial sums in [0, 1] within {request.tolerance:g} over the range of each mode's own um-{humps_of(number)}"
        least = least_of(found.lower, f"sequences of {what}")
        return Made(found.shaper, least, tuple(enumerate(bands)), () if least else (UNPROVEN,))
    humped = [unity_magnitude(mode, request.tolerance, number) for mode in request.modes]
    shaper = reduce(convolve, (one.shaper for one in humped))
    zeros = [zero for one in humped for zero in one.zeros]
    least = None
    if len(humped) == 1 and all(
        mode.decay < DECAYED for mode in request.modes
    ):  # with partial sums from 0 on there is nothing shorter either
        lower = least_up_to_one_of(humped[0].zeros, humped[0].dips)
        least = least_of(lower, summed((0.0, 1.0), own(humped, request.modes)), zeros)
    least = least or within_sums(zeros, sums_of(shaper), 0, own(humped, request.modes))
    return Made(shaper, least, notes=(*ripples(humped, request), *(() if least else (UNPROVEN,))))


def _modified(request: Request, number: int) -> Made:
    zeros, step = [(mode, 0) for mode in request.modes], request.sample_time
    if step is None:
        return compared(_in_turn(request.modes, mzv), zeros)
    shaper, needed = _in_turn(request.modes, lambda mode: mzv_on_samples(mode, step)), 0
    with suppress(SolverError):  # what is free needs less: that is then the bound
        needed = sampled(zeros, step).needed
    return _on_samples(Sampled(shaper, needed), step, zeros)


def _with_samples(
    shaper: Shaper, needed: int, among: str, sample_time: float, ranges: tuple[tuple[int, Band], ...] = (), zeros: Sequence[Mode] = ()
) -> Made:
    taken = rounded_down(needed * exact(repr(sample_time))) if needed else None
    least = least_of(taken, f"{among} at multiples of {sample_time!r} s, which need {needed}", zeros)
    return Made(shaper, least, ranges, () if least else (NO_FEWER,))


def _negative(request: Request, number: int) -> Made:
    negative, request = request.negative if request.negative is not None else math.nan, _each_once(request)
    modes = request.modes
    each = [negative_zv(mode, negative) for mode in modes]  # refuses what is no size of an amplitude
    if request.sample_time is not None:
        shaper, needed = negative_on_samples(modes, negative, request.sample_time)
        among = f"shapers with zero vibration whose negative amplitudes sum to at most {negative!r}"
        return _with_samples(shaper, needed, among, request.sample_time, zeros=modes)
    shaper = negative_at_once(modes, negative) if request.simultaneous and len(modes) > 1 else reduce(convolve, each)
    least = with_negative(shaper, [Remnant(mode) for mode in modes], "zero vibration")
    return Made(shaper, least, notes=() if least else (UNPROVEN,))


def _insensitive(request: Request, number: int) -> Made:
    reaches = request.reaches()
    bands = [band for _, band in reaches]
    among = "positive shapers within the tolerance over every band"
    if request.sample_time is not None:
        return _keeping_on_samples(tuple(dict.fromkeys(bands)), request.sample_time, among)
    if request.simultaneous or len(request.modes) == 1:
        shortest = within(bands)
        return Made(shortest.shaper, least_of(shortest.lower, among), notes=(shortest.note,) if shortest.note else ())
    each = [within([band for i, band in reaches if i == k]) for k in range(len(request.modes))]
    notes = [note for note in dict.fromkeys(one.note for one in each) if note]
    alone = max((one.lower for one in each if one.lower is not None), default=0.0)
    lower = max(alone, together) if (together := least_known(bands)) else alone or None
    if not together:
        notes.append(ONE_MODE)
    return Made(reduce(convolve, (one.shaper for one in each)), least_of(lower, among), notes=tuple(notes))


def _keeping_on_samples(bands: Sequence[Band], sample_time: float, among: str) -> Made:
    found = within_on_samples(bands, sample_time)
    return _with_samples(found.shaper, found.needed, among, sample_time)


def _unity(request: Request, number: int) -> Made:
    modes = different(request.modes) if request.simultaneous or request.sample_time is not None else request.modes
    if len(modes) == 1 or request.simultaneous or request.sample_time is not None:
        return _between(modes, (0.0, 1.0), number, request.sample_time)
    shaper = _in_turn(modes, lambda mode: bounded([mode], 0, 1, number).shaper)
    least = within_sums(modes, sums_of(shaper), number, "these zeros")
    return Made(shaper, least, notes=() if least else (UNPROVEN,))


def _sums(request: Request, number: int) -> Made:
    return _between(request.modes, request.sums or (0.0, 1.0), number, request.sample_time)


def _between(modes: Sequence[Mode], sums: tuple[float, float], number: int, sample_time: float | None = None) -> Made:
    low, high = bounds_of(sums)
    modes = different(modes)
    if sample_time is None:
        found = bounded(modes, low, high, number)
        least = least_of(found.lower, summed(sums, "these zeros"), modes)
        return Made(found.shaper, least, notes=() if least else (UNPROVEN,))
    shaper, needed = bounded_on_samples(modes, low, high, number, sample_time)
    what = f"these zeros at multiples of {sample_time!r} s, which need {needed}"
    least = least_of(rounded_down(needed * exact(repr(sample_time))) if needed else None, summed(sums, what), modes)
    return Made(shaper, least, notes=() if least else (UNPROVEN,))


def _on_off(request: Request, number: int) -> Made:
    height = request.height if request.height is not None else math.nan
    if request.sample_time is None:
        found = pulsed(different(request.modes), height, number)
    else:
        found = at_intervals(different(request.modes), height, request.sample_time, number)
    proven = found.lower
    if request.sample_time is not None and found.intervals:
        what = f"pulses of {height:g} 1/s that begin at multiples of {request.sample_time!r} s, of which {found.intervals} are needed"
        begins = rounded_down((found.intervals - 1) * exact(repr(request.sample_time)))  # the last pulse's
        return Made(found.shaper, least_of(max(begins, proven or 0.0), f"{what}, with these zeros"))
    return Made(found.shaper, least_of(proven, f"pulses of at most {height:g} 1/s with these zeros"))


def _deflected(request: Request, number: int) -> Made:
    sums = request.sums or (0.0, 1.0)
    bounds_of(sums)
    limit = request.deflection if request.deflection is not None else math.nan
    found = deflection_limited(request.modes, limit, sums, number, request.sample_time)
    least = within_sums(request.modes, sums, number, "these zeros, whatever they deflect")
    taken = rounded_down(found.needed * exact(repr(found.step)))
    # Drawn out to pulses a sequence deflects less: what is proven with a limit says nothing of those.
    if request.pulse is None and found.needed and (least is None or least.duration < taken):
        what = f"these zeros at multiples of {found.step!r} s that deflect no mode by more than {limit:g} there, which need {found.needed}"
        least = least_of(taken, summed(sums, what))
    return Made(found.shaper, least)


def _unshaped(request: Request, number: int) -> Made:
    return Made(Shaper((0.0,), (1.0,)), Least(0.0, "all shapers"))


def _given(request: Request, number: int) -> Made:
    assert request.impulses is not None
    if request.impulses.terms:
        raise ShaperError("what is computed here of a shaper is about impulses or pulses; this one has decaying terms")
    shaper = request.impulses
    times, amplitudes, order = shaper.exact_excitation
    remnants = []
    for mode in request.modes:
        omega, zeta = Fraction(mode.frequency), Fraction(mode.damping)
        remnants.append(Remnant(mode, worst_residual(times, amplitudes, (omega, omega), (zeta, zeta), order=order).upper))
    return Made(shaper, with_negative(shaper, remnants, "no more left of any mode than this one leaves"))


_PERIOD = (
    "asks for what mzv is not: it is told by 3/4 of one mode's period, and several modes have several; without it one for each mode is "
    "convolved, and zv with it is the shortest positive shaper of the same zeros"
)
_EITHER = frozenset({"simultaneous", "pulse"})
_PULSE = frozenset({"pulse"})
KINDS = (
    # It takes every option, so that a request can be compared with what is left without a shaper by changing one word.
    Kind("none", "none", "unshaped: one impulse at once", _unshaped, frozenset(OPTIONS)),
    Kind("zv, zvd, zvdd, zv-d:N", r"zv(?:(?P<d>d*)|-d:(\d+))", "zero vibration, and N derivatives of it", _derivatives,
         _EITHER | {"sample_time"}, zeros=all_modes),
    Kind("ei, N-hump-ei", r"(?:([1-9]\d*)-hump-)?ei", "extra insensitive: the tolerance at N humps", _humps,
         _EITHER | {"sample_time"}, zeros=between_humps),
    Kind("mzv", "mzv", "three impulses within 3/4 of the damped period", _modified, _PULSE | {"sample_time"},
         zeros=all_once, apart=_PERIOD),
    Kind("si", "si", "the shortest within the tolerance over the band", _insensitive,
         _EITHER | {"sample_time"}, keeps=True),
    Kind("um-zv, um-zvd, um-zv-d:N", r"um-zv(?:(?P<d>d*)|-d:(\d+))", "the same with impulses 1, -1, 1 …", _unity,
         _EITHER | {"sample_time"}, zeros=all_modes),
    Kind("um-ei, um-N-hump-ei", r"um-(?:([1-9]\d*)-hump-)?ei", "extra insensitive with impulses 1, -1, 1 …", _unity_humps,
         _EITHER | {"sample_time"},
         zeros=between_unity_humps),
    Kind("sna-zv", "sna-zv", "impulses A, -b, 1 + b - A", _negative, _EITHER | {"negative", "sample_time"}, frozenset({"negative"}),
         all_once),
    Kind("sums-zv, sums-zvd, sums-zv-d:N", r"sums-zv(?:(?P<d>d*)|-d:(\d+))", "the shortest with partial sums within bounds", _sums,
         _EITHER | {"sums", "sample_time"}, frozenset({"sums"}), all_modes),
    Kind("pulses-zv, pulses-zvd, pulses-zv-d:N", r"pulses-zv(?:(?P<d>d*)|-d:(\d+))", "pulses of one height and variable duration", _on_off,
         frozenset({"height", "sample_time", "simultaneous"}), frozenset({"height"}), all_modes),
    Kind("dl-zv, dl-zvd, dl-zv-d:N", r"dl-zv(?:(?P<d>d*)|-d:(\d+))", "the shortest that deflects no mode beyond a limit", _deflected,
         _EITHER | {"deflection", "sums", "sample_time"}, frozenset({"deflection"}), all_modes),
    Kind("custom", "custom", "impulses that are given", _given, _PULSE | {"impulses"}, frozenset({"impulses"})),
)  # fmt: skip
