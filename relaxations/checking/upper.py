"""The upper side: a command that provably exists. Some of its numbers (instants, levels, tail coefficients, the duration) are unknowns;
Krawczyk's test proves that exact values lie near those written, where the plant comes to rest, and the limits are checked on their balls.

One mechanism serves commands refined to exact switch times and staircases repaired on a grid (docs/theory.md, section 4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial

from flint import acb, arb, arb_mat, fmpq

from relaxations.checking.balls import Inconclusive, Plant, Refuted, Root, impulse, nearest, step, tail_room
from relaxations.checking.reading import Malformed, Task, UpperWitness

MOST_CELLS = 20_000


@dataclass(frozen=True, slots=True)
class Values:
    """A command in balls: deviations from the initial rest input."""

    time: arb
    starts: tuple[arb, ...]
    levels: tuple[arb, ...]
    tail: tuple[tuple[acb, ...], ...]


def written(witness: UpperWitness, rest: fmpq) -> Values:
    """The command as written."""
    tail = tuple(tuple(acb(re, im) for re, im in chain.coefficients) for chain in witness.tail)
    return Values(arb(witness.maneuver_time), tuple(map(arb, witness.starts)), tuple(arb(v - rest) for v in witness.levels), tail)


def moved(values: Values, free: Sequence[tuple[str, int, int]], changes: Sequence[arb]) -> Values:
    """The command with its unknowns changed."""
    time, starts, levels, tail = values.time, list(values.starts), list(values.levels), [list(c) for c in values.tail]
    for (kind, i, k), change in zip(free, changes, strict=True):
        match kind:
            case "time":
                time += change
            case "start":
                starts[i] += change
            case "level":
                levels[i] += change
            case "re":
                tail[i][k] += acb(change)
            case _:
                tail[i][k] += acb(0, change)
    return Values(time, tuple(starts), tuple(levels), tuple(map(tuple, tail)))


def _flat(plants: Sequence[Plant], rows: Sequence[Sequence[Sequence[acb]]]) -> list[arb]:
    """Complex moments of every plant, root and k as real equations."""
    flat: list[arb] = []
    for plant, own in zip(plants, rows, strict=True):
        for root, chain in zip(plant.roots, own, strict=True):
            for entry in chain:
                flat += [entry.real, entry.imag] if root.flexible else [entry.real]
    return flat


def _jumps(levels: Sequence[arb]) -> list[arb]:
    """The impulse at the beginning of each segment."""
    return [level - (levels[i - 1] if i else 0) for i, level in enumerate(levels)]


def residual(plants: Sequence[Plant], zeros: Sequence[Root], values: Values) -> list[arb]:
    """The moments of the command minus where they must be, tail included."""
    rows = []
    jumps = _jumps(values.levels)
    for plant in plants:
        own = []
        for root in plant.roots:
            chain = [-plant.target(root, k) for k in range(root.multiplicity)]
            for start, jump in zip(values.starts, jumps, strict=True):
                for k, s in enumerate(step(root, values.time - start)):
                    chain[k] += jump * s
            for zero, coefficients in zip(zeros, values.tail, strict=True):
                for power, c in enumerate(coefficients):
                    for k in range(root.multiplicity):
                        chain[k] -= _tail(plant, root, k, zero, power, c)
            own.append(chain)
        rows.append(own)
    return _flat(plants, rows)


def _tail(plant: Plant, root: Root, k: int, zero: Root, power: int, c: acb) -> acb:
    """The moment of `Re(c r^l/l! e^{zr})`: half of the term and half of its conjugate."""
    one, other = plant.tail(root, k, zero.value, power), plant.tail(root, k, zero.value.conjugate(), power)
    return (c * one + c.conjugate() * other) / 2


def jacobian(plants: Sequence[Plant], zeros: Sequence[Root], values: Values, free: Sequence[tuple[str, int, int]]) -> arb_mat:
    """Derivatives of the residual by each unknown, over balls of values."""
    jumps = _jumps(values.levels)
    ends = (*values.starts[1:], values.time)
    columns = []
    for kind, i, power in free:
        rows = []
        for plant in plants:
            own = []
            for root in plant.roots:
                m = root.multiplicity
                match kind:
                    case "time":
                        chain = [acb(0)] * m
                        for start, jump in zip(values.starts, jumps, strict=True):
                            chain = [c + jump * b for c, b in zip(chain, impulse(root.value, m, values.time - start), strict=True)]
                    case "start":
                        chain = [-jumps[i] * b for b in impulse(root.value, m, values.time - values.starts[i])]
                    case "level":
                        first, last = step(root, values.time - values.starts[i]), step(root, values.time - ends[i])
                        chain = [a - b for a, b in zip(first, last, strict=True)]
                    case _:
                        unit = acb(1) if kind == "re" else acb(0, 1)
                        chain = [-_tail(plant, root, k, zeros[i], power, unit) for k in range(m)]
                own.append(chain)
            rows.append(own)
        columns.append(_flat(plants, rows))
    return arb_mat(columns).transpose()


def solve(plants: Sequence[Plant], zeros: Sequence[Root], witness: UpperWitness, rest: fmpq) -> Values:
    """Krawczyk: `K = x - Y F(x) + (I - Y J(X)) (X - x)` inside X proves one solution in K; returns the command with its unknowns in K."""
    middle, free = written(witness, rest), witness.free
    size = sum(plant.size for plant in plants)
    if len(free) != size:
        raise Malformed(f"{size} equations need {size} unknowns, upper.free names {len(free)}")
    if size == 0:
        return middle
    spread = arb(0, arb(witness.radius).upper())
    wide = moved(middle, free, [spread] * size)
    at_middle = arb_mat([[x] for x in residual(plants, zeros, middle)])
    slopes = jacobian(plants, zeros, wide, free)
    try:
        inverse = arb_mat([[x.mid() for x in row] for row in slopes.tolist()]).inv()
    except ZeroDivisionError:
        raise Inconclusive("the equations for the unknowns are singular at this precision") from None
    inverse = arb_mat([[x.mid() for x in row] for row in inverse.tolist()])
    identity = arb_mat([[int(i == j) for j in range(size)] for i in range(size)])
    box = arb_mat([[spread] for _ in range(size)])
    newton = -(inverse * at_middle)
    image = newton + (identity - inverse * slopes) * box
    changes = [image[i, 0] for i in range(size)]
    if all(spread.contains_interior(change) for change in changes):
        return moved(middle, free, changes)
    if any(not spread.overlaps(change) for change in changes):
        raise Refuted("no command within the radius of the one written brings the plant to rest")
    raise Inconclusive("Krawczyk's test does not contract at this precision")


def _within(what: str, value: arb, lower: arb, upper: arb) -> None:
    if value < lower or value > upper:
        raise Refuted(f"{what} leaves the limits")
    if not (value >= lower and value <= upper):
        raise Inconclusive(f"{what} is not told from a limit at this precision")


def _limits(task: Task, witness: UpperWitness, values: Values) -> None:
    """Levels within the limits: those written exactly by rational comparison, the unknown ones by their balls."""
    unknown = {i for kind, i, _ in witness.free if kind == "level"}
    lower, upper = arb(task.lower_limit - task.initial_input), arb(task.upper_limit - task.initial_input)
    for i, level in enumerate(witness.levels):
        if i in unknown:
            _within(f"level {i}", values.levels[i], lower, upper)
        elif not task.lower_limit <= level <= task.upper_limit:
            raise Refuted(f"level {i} leaves the limits")


def _order(witness: UpperWitness, values: Values) -> None:
    """Instants ascend; where neither of two neighbours is an unknown, exactly."""
    unknown = {i for kind, i, _ in witness.free if kind == "start"} | ({len(witness.starts)} if ("time", 0, 0) in witness.free else set())
    exact, balls = (*witness.starts, witness.maneuver_time), (*values.starts, values.time)
    for i in range(len(exact) - 1):
        if i not in unknown and i + 1 not in unknown:
            if exact[i] > exact[i + 1]:
                raise Refuted(f"instant {i + 1} precedes instant {i}")
        elif balls[i] > balls[i + 1]:
            raise Refuted(f"instant {i + 1} precedes instant {i}")
        elif not balls[i] <= balls[i + 1]:
            raise Inconclusive(f"instants {i} and {i + 1} are not told apart at this precision")


@dataclass(frozen=True, slots=True)
class _Tail:
    """`Σ Re(c r^l/l! e^{zr})` over stable zeros."""

    zeros: tuple[Root, ...]
    chains: tuple[tuple[acb, ...], ...]

    def __call__(self, r: arb) -> arb:
        total = arb(0)
        for zero, chain in zip(self.zeros, self.chains, strict=True):
            growth = (zero.value * r).exp()
            total += sum(((c * growth).real * r**k / factorial(k) for k, c in enumerate(chain)), arb(0))
        return total

    def derivative(self) -> _Tail:
        """d/dr."""
        chains = tuple(
            tuple(zero.value * c + d for c, d in zip(chain, (*chain[1:], acb(0)), strict=True))
            for zero, chain in zip(self.zeros, self.chains, strict=True)
        )
        return _Tail(self.zeros, chains)

    def envelope(self, r: arb) -> list[arb]:
        """`Σ |c| r^l/l! e^{Re z r}` of each zero; each falls from r = l/|Re z| on."""
        return [
            sum((abs(c) * r**k / factorial(k) * (zero.value.real * r).exp() for k, c in enumerate(chain)), arb(0))
            for zero, chain in zip(self.zeros, self.chains, strict=True)
        ]

    def settled(self, r: arb, above: fmpq, below: fmpq) -> bool:
        """Whether the tail is within its room from r on: by its envelope, or, with no room on one side, by the sign of its slowest term."""
        parts = self.envelope(r)
        if sum(parts, arb(0)) <= arb(min(above, below)):
            return True
        slowest = max(range(len(self.zeros)), key=lambda i: float(self.zeros[i].value.real.mid()))
        zero, chain = self.zeros[slowest], self.chains[slowest]
        slower = all(zero.value.real > other.value.real for other in self.zeros if other is not zero)
        if zero.flexible or len(chain) != 1 or not slower or not (above == 0 or below == 0):
            return False
        # The others' envelopes fall faster than the slowest term, so what it outweighs at r it outweighs for ever.
        others = sum((part for i, part in enumerate(parts) if i != slowest), arb(0))
        inward = chain[0].real < 0 if above == 0 else chain[0].real > 0
        return bool(inward and others < parts[slowest] and sum(parts, arb(0)) <= arb(max(above, below)))


def _tail_limits(task: Task, zeros: tuple[Root, ...], values: Values, rest: fmpq, touch: fmpq | None) -> None:
    """The tail within its limits for ever: on [0, far] by subdivision, beyond as `settled` says; `touch` is its first value if exact."""
    if not any(not c.is_zero() for chain in values.tail for c in chain):
        return
    tail = _Tail(zeros, values.tail)
    later = fmpq(0) if task.tail_length is None else task.tail_length[0]
    last = tail_room(task, rest, later)
    far = max(float((arb(len(chain) + 1) / -zero.value.real).upper()) for zero, chain in zip(zeros, values.tail, strict=True))
    far = max(far, float(arb(later).upper()))
    for _ in range(60):
        if tail.settled(arb(far), *last):
            break
        far *= 2
    else:
        raise Inconclusive("the tail does not settle within the limits: the final rest input may lie on one")
    # The tighter limits of a tail length count from its time on; the cell that holds that time obeys both.
    pieces = [(arb(0), arb(later).upper(), tail_room(task, rest, fmpq(-1)))] if later > 0 else []
    pieces.append((arb(later).lower(), arb(far), last))
    for start, end, (above, below) in pieces:
        begin = start
        if touch is not None and start == 0 and (touch == above or touch == -below):
            begin = _leaves(tail.derivative(), end, touch == above)
        _inside(tail, begin, end, -arb(below), arb(above))


def _leaves(slope: _Tail, end: arb, falling: bool) -> arb:
    """An instant up to which a tail that begins on a limit moves away from it."""
    for _ in range(200):
        value = slope(arb(0).union(end))
        if value < 0 if falling else value > 0:
            return end
        end = (end / 2).mid()
    raise Inconclusive("the tail begins on a limit and does not provably leave it")


def _inside(tail: _Tail, start: arb, end: arb, lower: arb, upper: arb) -> None:
    """lower ≤ tail ≤ upper on [start, end], by subdivision."""
    waiting, cells = [(start, end)], 0
    while waiting:
        a, b = waiting.pop()
        cells += 1
        if cells > MOST_CELLS:
            raise Inconclusive("the tail is not told from a limit within the cap on subdivision")
        value = tail(a.union(b))
        if value >= lower and value <= upper:
            continue
        at = tail(a)
        if at < lower or at > upper:
            raise Refuted("the tail leaves the limits")
        middle = ((a + b) / 2).mid()
        waiting += [(a, middle), (middle, b)]


def prove(task: Task, plants: Sequence[Plant], witness: UpperWitness, time: fmpq) -> None:
    """Prove that an admissible command of at most `time` seconds exists; raises `Refuted` or `Inconclusive`."""
    zeros = _tail_zeros(plants, witness)
    values = solve(plants, zeros, witness, task.initial_input)
    _order(witness, values)
    _limits(task, witness, values)
    _tail_limits(task, zeros, values, plants[0].rest_input, None if witness.starts else _first_value(task, plants[0]))
    if ("time", 0, 0) not in witness.free:
        if witness.maneuver_time > time:
            raise Refuted("the command takes longer than the upper bound that is claimed")
    elif values.time > arb(time):
        raise Refuted("the command takes longer than the upper bound that is claimed")
    elif not values.time <= arb(time):
        raise Inconclusive("the command's duration is not told from the upper bound that is claimed")


def _first_value(task: Task, plant: Plant) -> fmpq | None:
    """u(0+) - u_ss of a command that is all tail: the output jumps to its target through the feed-through, `u = u_0 + Δ/D`, exact."""
    (data,) = task.plants
    return task.displacement / data.numerator[-1] - plant.rest_input if len(data.numerator) == len(data.denominator) else None


def _tail_zeros(plants: Sequence[Plant], witness: UpperWitness) -> tuple[Root, ...]:
    """The zeros that the witness's tail uses; each a stable zero of the plant, within its multiplicity, named once."""
    zeros = []
    for chain in witness.tail:
        if not plants[0].zeros:
            raise Malformed("a tail needs an output rest and a zero left of the imaginary axis")
        zero = nearest(plants[0].zeros, chain.near)
        if any(zero is other for other in zeros) or len(chain.coefficients) > zero.multiplicity:
            raise Malformed("upper.tail names a zero twice, or more powers than its multiplicity")
        if not zero.flexible and any(im != 0 for _, im in chain.coefficients):
            raise Malformed("the coefficients at a real zero are real")
        zeros.append(zero)
    for kind, i, _ in witness.free:
        if kind == "im" and not zeros[i].flexible:
            raise Malformed("the coefficients at a real zero have no imaginary part to solve for")
    return tuple(zeros)
