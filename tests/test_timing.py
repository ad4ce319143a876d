"""What errors of timing leave: derivatives, delays and worst cases against simulation by matrix exponentials, which knows none of it."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import tf2ss

from relaxations import timing
from relaxations.commands import Command, Segment, Tail, TailTerm
from relaxations.errors import CommandError
from relaxations.plants import LinearPlant
from relaxations.timing import Event
from relaxations.timing_worst import TIGHT, worst
from suite.cli import main
from suite.loading import load_study
from suite.timings import Asked, study_timing

Reals = NDArray[np.float64]

TWO_MASS = ([1.0], [1.0, 0.0, 2.0, 0.0, 0.0])  # ω = √2, of two unit masses
PLANTS = {
    "two masses": TWO_MASS,
    "damped, with a real pole": ([0.3, 1.0], list(np.polymul([1.0, 0.3, 4.0], [1.0, 0.7]))),
    # in doubles exactly, or they would be two close ones
    "repeated poles": ([1.0], list(np.polymul(np.polymul([1.0, 0.5, 3.0], [1.0, 0.5, 3.0]), np.polymul([1.0, 1.0], [1.0, 1.0])))),
    "three integrators": ([1.0], [1.0, 0.0, 0.0, 0.0]),
}
# The fastest move of the two masses by 5 m (`suite/problems/two_mass_5.toml`).
SWITCHES = (0.0, 2.9607300331, 3.33136421, 3.7019983878, 6.6627284203)


def command(times: Sequence[float], levels: Sequence[float]) -> Command:
    """Levels from each time but the last on, then 0."""
    return Command(times[-1] - times[0], tuple(Segment(t, level) for t, level in zip(times[:-1], levels, strict=True)), Tail(0.0))


def free(numerator: Sequence[float], denominator: Sequence[float], events: Sequence[tuple[float, float]], at: Reals) -> Reals:
    """The output at times `at` after all events (instant, jump), by one matrix exponential for each piece."""
    A, B, C, _ = tf2ss(numerator, denominator)
    n = len(A)
    both = np.zeros((n + 1, n + 1))
    both[:n, :n], both[:n, n] = A, B[:, 0]
    state, level, now = np.zeros(n), 0.0, min(instant for instant, _ in events)
    for instant, jump in sorted(events):
        state = (expm(both * (instant - now)) @ np.append(state, level))[:n]
        level, now = level + jump, instant
    return np.array([float(np.squeeze(C @ (expm(both * (t - now)) @ np.append(state, level))[:n])) for t in at])


def told(plant: LinearPlant, events: Sequence[Event], end: float, errors: Reals, at: Reals) -> Reals:
    """The output after the move as its free motions say: each of them z, going on with its pole."""
    y = np.zeros(len(at))
    for motion in timing.motions(plant, 0.0):
        if motion.unit:
            continue
        instants = np.array([event.instant for event in events]) + errors
        jumps = np.array([event.jump for event in events])
        y += motion.factor * (motion(at[:, None] - instants) @ jumps).real
    return y


@pytest.mark.parametrize("name", PLANTS)
def test_the_motions_are_the_whole_output_after_the_move(name: str):
    numerator, denominator = PLANTS[name]
    plant = LinearPlant.from_transfer(numerator, denominator)
    events = timing.events(command((0.0, 0.9, 1.3, 2.6), (1.0, -0.5, 0.7)))
    rng = np.random.default_rng(3)
    errors = rng.uniform(-0.05, 0.05, len(events))
    at = np.linspace(3.0, 9.0, 13)
    shifted = [(event.instant + error, event.jump) for event, error in zip(events, errors, strict=True)]
    expected = free(numerator, denominator, shifted, at)
    assert told(plant, events, 2.6, errors, at) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())  # expm's rounding


@pytest.mark.parametrize("name", PLANTS)
def test_derivatives_are_those_of_what_is_left(name: str):
    plant = LinearPlant.from_transfer(*PLANTS[name])
    events, end = timing.events(command((0.0, 0.9, 1.3, 2.6), (1.0, -0.5, 0.7))), 2.6
    for motion in timing.motions(plant, 1.0):
        slopes = timing.derivatives(motion, events, end)
        step = 1e-5 * np.eye(len(events))
        central = (timing.left(motion, events, end, step) - timing.left(motion, events, end, -step)) / 2e-5
        assert slopes == pytest.approx(central, rel=1e-7, abs=1e-8)  # h² = 1e-10 times third derivatives, and rounding/h


def test_the_planned_move_leaves_nothing_and_a_shift_of_all_instants_leaves_nothing_else():
    move = load_study(Path("suite/problems/two_mass_5.toml"))
    for on in (0.0, 0.25):
        done = study_timing(move, Asked(on=on, off=on))
        assert [one.motion.name for one in done.left] == ["rigid displacement", "rigid rate", "mode[1]"]
        assert [abs(one.delayed) for one in done.left] == pytest.approx([0.0, 0.0, 0.0], abs=1e-13)


def test_delays_of_thrusters_against_simulation():
    """A reversal with off later than on overlaps: both thrusters push, and the torques cancel; the other way there is a pause."""
    planned = timing.events(command(SWITCHES, (1.0, -1.0, 1.0, -1.0)))
    assert len(planned) == 8
    for on, off in ((0.05, 0.12), (0.12, 0.05)):
        happening, notes = timing.delayed(planned, on, off)
        assert not notes
        opened = [(t + on, jump) for t, jump in zip(SWITCHES[:-1], (1.0, -1.0, 1.0, -1.0), strict=True)]
        closed = [(t + off, jump) for t, jump in zip(SWITCHES[1:], (-1.0, 1.0, -1.0, 1.0), strict=True)]
        at = np.linspace(7.0, 7.0 + 2 * np.pi / np.sqrt(2), 400)
        y = free(*TWO_MASS, [*opened, *closed], at)
        line = np.polyfit(at, y - told_mode(happening, at), 1)
        rest, rate, mode = timing.motions(LinearPlant.from_transfer(*TWO_MASS), 5.0)
        assert timing.left(rate, happening, SWITCHES[-1]).real == pytest.approx(line[0], abs=1e-9)
        assert timing.left(rest, happening, SWITCHES[-1]).real == pytest.approx(np.polyval(line, SWITCHES[-1]) - 5.0, abs=1e-8)
        swing = y - np.polyval(line, at)
        assert mode.size(np.array(timing.left(mode, happening, SWITCHES[-1]))) == pytest.approx(
            np.abs(swing).max(), rel=1e-4
        )  # 400 samples


def told_mode(events: Sequence[Event], at: Reals) -> Reals:
    mode = timing.motions(LinearPlant.from_transfer(*TWO_MASS), 5.0)[2]
    instants, jumps = (np.array([getattr(event, name) for event in events]) for name in ("instant", "jump"))
    return 2.0 * (mode(at[:, None] - instants) @ jumps).real


def test_a_pulse_that_closes_before_it_opens_does_not_happen_and_pulses_that_meet_are_one():
    planned = timing.events(command((0.0, 1.0, 1.1, 2.0, 2.05, 3.0), (1.0, 0.0, 1.0, 0.0, -1.0)))
    happening, notes = timing.delayed(planned, 0.0, 0.2)  # the pause of 0.1 s is filled
    assert "stays open" in notes[0]
    assert len(notes) == 1
    middle = [event.instant for event in happening if event.thruster == 0][1:3]
    assert middle[0] == middle[1]
    planned = timing.events(command((0.0, 1.0, 2.0, 2.05, 3.0), (1.0, 0.0, -1.0, 0.0)))
    happening, notes = timing.delayed(planned, 0.2, 0.1)  # the pulse of 0.05 s is not
    assert "does not open" in notes[0]
    short = [event for event in happening if event.thruster == 1]
    assert short[0].instant == short[1].instant


def test_levels_are_thrusters_on_one_another():
    events = timing.events(command((0.0, 1.0, 2.0, 3.0), (1.0, 3.0, -2.0)), 0.0)
    assert [(e.instant, e.jump, e.opens, e.thruster) for e in events] == [
        (0.0, 1.0, True, 0), (1.0, 2.0, True, 1), (2.0, -1.0, False, 0), (2.0, -2.0, False, 1), (2.0, -2.0, True, 2), (3.0, 2.0, False, 2),
    ]  # fmt: skip
    assert [e.jump for e in timing.events(command((0.0, 1.0, 2.0, 3.0), (1.0, 3.0, -2.0)), together=True)] == [1.0, 2.0, -5.0, 2.0]


@pytest.mark.parametrize("name", PLANTS)
def test_no_errors_within_the_limit_leave_more_than_the_bound_and_some_nearly_that(name: str):
    plant = LinearPlant.from_transfer(*PLANTS[name])
    events, end, within = timing.events(command((0.0, 0.9, 1.3, 2.6), (1.0, -0.5, 0.7)), together=True), 2.6, 0.15
    rng = np.random.default_rng(5)
    corners = within * np.array(list(itertools.product((-1.0, 1.0), repeat=len(events))))
    grid = within * np.array(list(itertools.product(np.linspace(-1, 1, 9), repeat=len(events))))
    tried = np.vstack([corners, grid, rng.uniform(-within, within, (20_000, len(events)))])
    for motion in timing.motions(plant, 1.0):
        found = worst(motion, events, end, within)
        assert np.abs(found.errors).max() <= within
        assert abs(timing.sampled(motion, events, end, found.errors[None])[0]) == pytest.approx(found.attained, rel=1e-12)
        seen = np.abs(timing.sampled(motion, events, end, tried)).max()
        assert seen <= found.bound
        assert found.attained <= found.bound <= found.attained * (1 + 2 * TIGHT)
        assert seen >= 0.995 * found.bound  # a grid of nine values each comes so near


def test_the_worst_of_a_rigid_body_in_closed_form():
    """1/s²: a rate of δ Σ|a|; at the end, each instant's part a (s ± δ)²/2 - a s²/2 = |a| (s δ + δ²/2), or less where it shortens."""
    plant = LinearPlant.from_transfer([1.0], [1.0, 0.0, 0.0])
    events, end, within = timing.events(command((0.0, 1.0, 2.0), (1.0, -1.0)), together=True), 2.0, 0.1
    place, rate = timing.motions(plant, 1.0)
    assert worst(rate, events, end, within).bound == pytest.approx(0.4, rel=1e-12)
    late = 0.2 - 0.005 + (0.2 + 0.01) + 0.0  # jump 1 later, -2 later … of the side that falls short: -(2·0.1 - 0.005), -2(0.1·1 + 0.005), 0
    early = 0.2 + 0.005 + 2 * (0.1 - 0.005) + 0.005
    assert worst(place, events, end, within).bound == pytest.approx(max(late, early), rel=1e-6)


def test_jitter_to_first_order_and_drawn():
    plant = LinearPlant.from_transfer(*TWO_MASS)
    events, end, jitter = timing.events(command(SWITCHES, (1.0, -1.0, 1.0, -1.0))), SWITCHES[-1], 2e-3
    errors = np.random.default_rng(1).normal(0.0, jitter, (100_000, len(events)))
    for motion in timing.motions(plant, 5.0):
        drawn = timing.sampled(motion, events, end, errors)
        # 1/√(2 · 100 000) is 0.2 % of a root mean square; five of those, and what is of second order
        assert timing.root_mean_square(motion, events, end, jitter) == pytest.approx(np.sqrt(np.mean(drawn**2)), rel=0.012)
    # One event where both thrusters act at once moves twice the jump: its square counts double.
    rate = timing.motions(plant, 5.0)[1]
    joint = timing.events(command(SWITCHES, (1.0, -1.0, 1.0, -1.0)), together=True)
    assert timing.root_mean_square(rate, events, end, jitter) == pytest.approx(0.5 * jitter * np.sqrt(8.0), rel=1e-9)
    assert timing.root_mean_square(rate, joint, end, jitter) == pytest.approx(0.5 * jitter * np.sqrt(14.0), rel=1e-9)


def test_the_error_that_a_requirement_allows_is_the_largest(tmp_path: Path):
    file = tmp_path / "study.toml"
    file.write_text(Path("suite/studies/thrusters.toml").read_text().replace("pulse_width = 0.8", ""))  # the search takes long
    done = study_timing(load_study(file), Asked())
    assert done.limit == ("THRUST-001", 1e-6)
    assert done.allowed is not None
    assert done.swinging(done.allowed)[1] <= 1e-6 < done.swinging(done.allowed * 1.002)[1]
    assert done.swinging(done.allowed * 1.01)[0] > 1e-6  # one mode: what is attained exceeds it, so no larger error would do


def test_slopes_and_tails_have_no_instants():
    for wrong in (
        Command(1.0, (Segment(0.0, 1.0, 0.5),), Tail(0.0)),
        Command(1.0, (Segment(0.0, 1.0),), Tail(0.0, (TailTerm(-1 + 0j, 0, 1 + 0j),))),
        Command(0.0, (), Tail(0.0)),
    ):
        with pytest.raises(CommandError):
            timing.events(wrong)


# The command line.

STUDY = "suite/problems/two_mass_5.toml"


def test_one_object_and_the_same_draws_from_the_same_seed(tmp_path: Path):
    words = ["timing", STUDY, "--on-delay", "0.01", "--off-delay", "0.02", "--jitter", "0.002", "--within", "0.01", "--samples", "500"]
    first, again, other = (CliRunner().invoke(main, [*words, *more, "--json"]) for more in ([], [], ["--seed", "1"]))
    assert first.exit_code == 0
    assert first.stdout == again.stdout != other.stdout
    record = json.loads(first.stdout)
    assert [motion["name"] for motion in record["motions"]] == ["rigid displacement", "rigid rate", "mode[1]"]
    assert len(record["events"]) == 8
    mode = record["motions"][2]
    assert mode["worst"]["attained"] <= mode["worst"]["bound"] == pytest.approx(record["modes_together"] * 5.0)
    assert mode["jitter"]["largest"] > mode["jitter"]["p95"] > mode["jitter"]["rms"] / 2


def test_repeated_flexible_modes_are_refused(tmp_path: Path):
    """What is left of them may grow after the move: twice |z| is no amplitude then."""
    file = tmp_path / "repeated.toml"
    plant = "[plant]\nnumerator = [1]\ndenominator = [1, 0.4, 2.04, 0.4, 1]\n"
    file.write_text(f'title = "a"\n{plant}[maneuver]\ndisplacement = 1\n[limits]\ninput = [-1, 3]\n')
    done = CliRunner().invoke(main, ["timing", str(file), "--within", "0.01"])
    assert done.exit_code == 2
    assert "mode[1] is a repeated pole" in " ".join(done.output.split())


def test_tables_and_picture(tmp_path: Path):
    drawn = tmp_path / "timing.svg"
    done = CliRunner().invoke(main, ["timing", STUDY, "--within", "0.01", "--jitter", "0.001", "--samples", "100", "--plot", str(drawn)])
    assert done.exit_code == 0, done.output
    assert "worst, proved" in done.stdout
    assert "leave at most" in done.stdout
    text = drawn.read_text()
    assert "error of each instant [s]" in text
    assert "mode[1]: no instant errs by more, worst: proven" in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["suite/studies/aircraft_pitch.toml"], "tail"),
        (["suite/problems/two_mass_rate.toml"], "slope"),
        (["suite/problems/swinging_load.toml"], "begins elsewhere"),
        (["suite/problems/impossible_fuel.toml"], "there is none"),
        ([STUDY, "--within", "1"], "shortest pulse or pause"),
        ([STUDY, "--jitter", "0.2"], "shortest pulse or pause"),
        ([STUDY, "--reversals", "together", "--on-delay", "0.1"], "one delay"),
        ([STUDY, "--on-delay", "-1"], "x>=0"),
        ([STUDY, "--on-delay", "1e300"], "--on-delay 1e+300: a delay lasts no longer than the command"),
        ([STUDY, "--off-delay", "1e4"], "--off-delay 10000: a delay lasts no longer than the command"),
        ([STUDY, "--on-delay", "6"], "no pulse opens at all"),
        ([STUDY, "--jitter", "nan"], "nan"),
        ([STUDY, "--within", "inf"], "finite"),
        ([STUDY, "--samples", "1"], "2<=x"),
        ([STUDY, "--plot", "picture.png"], "SVG"),
        (["nowhere.toml"], "nowhere.toml"),
    ],
    ids=lambda given: " ".join(given) if isinstance(given, list) else given,
)
def test_what_makes_no_sense_is_told(words: list[str], said: str):
    done = CliRunner().invoke(main, ["timing", *words])
    assert done.exit_code == 2
    assert said in done.output
    assert "Traceback" not in done.output


def random_plant(rng: np.random.Generator) -> LinearPlant:
    """One to three factors, of coefficients that doubles hold exactly: rigid, real, flexible, repeated now and then."""
    denominator = np.array([1.0])
    for kind in rng.choice(["mode", "mode", "real", "rigid"], rng.integers(1, 4)):
        frequency, damping = 2.0 ** rng.integers(-3, 5), rng.choice([0.0, 0.0625, 0.25, 0.5])
        factor = {"mode": [1.0, 2 * damping * frequency, frequency**2], "real": [1.0, frequency], "rigid": [1.0, 0.0]}[kind]
        denominator = np.polymul(denominator, factor)
    numerator = rng.integers(1, 5, rng.integers(1, len(denominator))).astype(float)
    return LinearPlant.from_transfer(numerator.tolist(), denominator.tolist())


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(40))
def test_random_errors_of_random_moves_leave_no_more_than_the_bound(seed: int):
    rng = np.random.default_rng(seed)
    plant, count = random_plant(rng), int(rng.integers(2, 7))
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.3, 2.0, count))]).tolist()
    events = timing.events(command(times, [1.0, *rng.choice([-1.0, 0.0, 0.5, 1.0], count - 1)]), together=bool(rng.integers(2)))
    within = min(timing.room(events), 2.0) / 2 * 10.0 ** rng.uniform(-4, 0)
    tried = np.vstack([rng.uniform(-within, within, (3000, len(events))), within * rng.choice([-1.0, 1.0], (2000, len(events)))])
    for motion in timing.motions(plant, 1.0):
        found = worst(motion, events, times[-1], within)
        seen = float(np.abs(timing.sampled(motion, events, times[-1], tried)).max())
        assert seen <= found.bound * (1 + 1e-12)  # what is seen is computed in doubles
        assert found.bound <= found.attained * (1 + 2 * TIGHT)
