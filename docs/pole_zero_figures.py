"""The figures of the paper on pole-zero cancelling shapers, drawn from the filters that are designed here.

    .venv/bin/python docs/pole_zero_figures.py FOLDER     writes them (SVG) into FOLDER

Figs. 1 to 14: a mode of 1 rad/s without damping (the examples: √2 rad/s), zeros varied; Figs. 15 to 19: the pitch of an aircraft, Fig. 19
for eleven plants, here in closed form (`slewcert compare` of the pair of studies `aircraft_pitch_cancelled` draws the like from runs of the
FMU).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pole_zero_claims import AFTER, HARMONIC, ROOT_2, TURN, course, elevator, eleven, filters, reference

from relaxations.cancelling.closed_forms import pole_first, pole_last, step_and_pole_last
from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.sweeps import share, sweep
from relaxations.plants import LinearPlant
from relaxations.response import response
from relaxations.shaping.modes import Mode
from reports import charts
from reports.bundle_charts import Bundle, Run, bundles
from reports.prefilter_charts import families

RECIPROCALS = np.linspace(0.0, 8.0, 161)[1:]  # 1/α [s]
DAMPINGS = (0.0, 0.25, 0.5, 0.75, 1.0)  # φ of the complex zeros
FREQUENCIES = np.linspace(2.0, 10.0, 81)  # ψ [rad/s]
Reals = NDArray[np.float64]


def parametrisation_1() -> str:
    """Figs. 1 and 2: the pole on the delayed term."""
    made = sweep(lambda r: pole_last(HARMONIC, [-1.0 / r]), RECIPROCALS.tolist())
    gains = {
        "A, at once": (RECIPROCALS, [one.step(0) for one in made]),
        "the delayed term with the pole": (RECIPROCALS, [one.term(1) for one in made]),
    }
    across = "1/α [s]"
    return families(
        "Figs. 1 and 2: switch time and gains, the pole on the delayed term",
        (across, "switch time [s]", {"pole-zero cancelling": (RECIPROCALS, [one.duration for one in made])}),
        (across, "share of the static gain", gains),
        level=math.pi,
    )


def parametrisation_2() -> str:
    """Figs. 4 and 5: the pole on the undelayed term."""
    made = sweep(lambda r: pole_first(HARMONIC, [-1.0 / r]), RECIPROCALS.tolist())
    gains = {
        "the undelayed term with the pole": (RECIPROCALS, [one.term(0) for one in made]),
        "A, delayed": (RECIPROCALS, [one.step(1) for one in made]),
    }
    across = "1/α [s]"
    return families(
        "Figs. 4 and 5: switch time and gains, the pole on the undelayed term",
        (across, "switch time [s]", {"pole-zero cancelling": (RECIPROCALS, [one.duration for one in made])}),
        (across, "share of the static gain", gains),
        most=(None, 12.0),
        level=math.pi,
    )


def parametrisation_3() -> str:
    """Figs. 6 to 8: a step and the pole on one delay that is given; α = 1, which the paper does not say."""
    times = np.arange(0.013, 12.0, 0.01)
    raw: list[tuple[float, float]] = []
    shares: list[tuple[float, float, float]] = []
    for t in times.tolist():
        turned, at = complex(math.cos(t), -math.sin(t)), complex(1.0, 1.0)
        second = -(turned / at).imag / turned.imag
        raw.append((-(second * turned + turned / at).real, second))
        one = step_and_pole_last(HARMONIC, [-1.0], t)
        shares.append((one.gains[0] / one.gain, one.gains[1] / one.gain, share(one, t)))
        ratio = raw[-1][0] / raw[-1][1] - one.gains[0] / one.gains[1]
        assert abs(ratio) < 1e-6 * (1.0 + abs(raw[-1][0] / raw[-1][1]))  # the filter's gains are these, normalised
    names = ("A_1, at once", "A_2, delayed", "the delayed term with the pole")
    first = {name: (times, [row[k] for row in raw]) for k, name in enumerate(names[:2])}
    second_ = {name: (times, [row[k] for row in shares]) for k, name in enumerate(names)}
    positive = {name: (times, [row[k] if min(row) >= 0.0 else math.nan for row in shares]) for k, name in enumerate(names)}
    return families(
        "Figs. 6 to 8: gains against the delay, normalised, and where all are positive",
        ("delay T [s]", "gains before normalising", first),
        ("delay T [s]", "share of the static gain", second_),
        ("delay T [s]", "… where all are positive", positive),
        most=(5.0, 5.0),
    )


def _families(title: str, pick: Callable[[float, float], Prefilter], values: Sequence[float], over: Reals, name: str, across: str) -> str:
    made = {value: sweep(lambda x, value=value: pick(value, x), over.tolist()) for value in values}
    times = {f"{name} = {value:g}": (over, [one.duration for one in row]) for value, row in made.items()}
    gains = {f"{name} = {value:g}": (over, [one.step(0) for one in row]) for value, row in made.items()}
    return families(title, (across, "switch time [s]", times), (across, "A, share of the static gain", gains), level=math.pi)


def complex_zeros() -> str:
    """Figs. 9 and 10, whose surfaces are drawn as curves."""

    def pick(damping: float, frequency: float) -> Prefilter:
        z = frequency * complex(-damping, math.sqrt(1.0 - damping**2))
        if damping == 0.0:  # on the axis: the limit of the family is the shaper that leaves it alone
            return pole_last(HARMONIC, [])
        return pole_last(HARMONIC, [z, z.conjugate()])

    return _families("Figs. 9 and 10: complex zeros", pick, DAMPINGS, FREQUENCIES, "φ", "frequency ψ of the zeros [rad/s]")


def real_zeros() -> str:
    """Figs. 12 and 13."""
    pick = lambda beta, alpha: pole_last(HARMONIC, [-alpha, -beta])  # noqa: E731 - a formula
    return _families("Figs. 12 and 13: real zeros", pick, (2.0, 4.0, 6.0, 8.0, 10.0), FREQUENCIES, "β", "α [1/s]")


def responses() -> str:
    """Figs. 3, 11 and 14: the output with the filter and with the shaper that leaves the zeros alone."""
    times, zero, mode = np.linspace(0.0, 6.0, 601), complex(-1.0, ROOT_2), Mode(ROOT_2, 0.0)
    parts = []
    for numerator, zeros, figure in (((1, 1), [-1.0], 3), ((1, 2, 3), [zero, zero.conjugate()], 11), ((1, 3, 2), [-1.0, -2.0], 14)):
        plant = LinearPlant.from_transfer(numerator, [1, 0, 2])
        usual = pole_last(mode, []).scaled(1.0 / numerator[-1])
        curves = {
            label: (times, response(plant, one.command(1.0), times))
            for label, one in (("pole-zero cancelling", pole_last(mode, zeros)), ("shaper that leaves the zeros alone", usual))
        }
        parts.append(("time [s]", f"output, Fig. {figure}", curves))
    return families("Figs. 3, 11, 14: outputs of the examples", *parts)


def pitch(title: str, names: Mapping[str, str], until: float) -> str:
    """References and elevators of the aircraft's turn."""
    seen = np.flatnonzero(until >= AFTER)[::2]
    times = AFTER[seen]
    return families(
        title,
        ("time [s]", "reference [rad]", {label: (times, reference(name)[seen]) for label, name in names.items()}),
        ("time [s]", "elevator [rad]", {label: (times, elevator(name)[seen]) for label, name in names.items()}),
        steps=True,
    )


def eleven_plants() -> str:
    """Fig. 19: the pitch of eleven plants under the nominal and the robust reference."""
    times, plants = np.linspace(0.0, 15.0, 501), eleven()
    shown = [
        Bundle(label, [Run(times, course(name, one, times), one == plants[5], False) for one in plants], filters()[name].duration)
        for label, name in (("(58), nominal", "cancelling"), ("(65), robust", "robust"))
    ]
    title = "Fig. 19: eleven plants, the coefficient of s² within 30 %"
    return charts.standalone(bundles(title, shown, target=TURN, output_label="pitch [rad]", until=15.0))


def figures() -> dict[str, str]:
    """The files' names, without ending, and their content."""
    times = {name: f"{one.duration:.3f} s" for name, one in filters().items()}
    three = {
        f"pole-zero cancelling, {times['cancelling']}": "cancelling",
        f"steps alone, concurrent, {times['steps']}": "steps",
        f"steps alone, cascade, {times['cascade']}": "cascade",
    }
    two = {f"nominal, {times['cancelling']}": "cancelling", f"with a further zero at the mode, {times['robust']}": "robust"}
    return {
        "01_02_pole_on_the_delay": parametrisation_1(),
        "04_05_pole_at_once": parametrisation_2(),
        "06_07_08_given_delay": parametrisation_3(),
        "09_10_complex_zeros": complex_zeros(),
        "12_13_real_zeros": real_zeros(),
        "03_11_14_outputs": responses(),
        "15_16_three_references": pitch(f"Figs. 15 and 16: three references that turn by {TURN:g} rad", three, 8.0),
        "17_18_robust": pitch("Figs. 17 and 18: the nominal and the robust reference", two, 15.0),
        "19_eleven_plants": eleven_plants(),
    }


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("name the folder for the figures")
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for file, content in figures().items():
        (folder / f"{file}.svg").write_text(content)
        print(folder / f"{file}.svg")
