"""The study: what is asked of which plant, as meant. `suite.loading` reads one from its TOML file.

Numbers that a proof rests on (plant, maneuver, limits, parameter ranges) stay exact decimals; the others are floats.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fmus.confinement import Confinement
from relaxations.commands import Command
from relaxations.robust.moved import Move
from relaxations.shaping.requests import Request
from suite.quantity_names import Quantity

if TYPE_CHECKING:
    from fmus.archives import Fmu
    from fmus.stepping import Probe

GRID = 11  # samples of one uncertain parameter, unless said otherwise

Exact = Decimal
Complex = tuple[Decimal, Decimal]
"""(re, im)."""


@dataclass(frozen=True, slots=True)
class FmuPlant:
    """An FMU and the start values that the study sets on it; `name` as written in the study.

    It settles for `settle` [s] (infinite: until it rests) before anything begins. `linearization` names the linear plant that is asked
    for, `identification` what of an identification is given. `step` is the study's communication step [s], if it asks for one.
    """

    name: str
    archive: Fmu
    parameters: Mapping[str, Decimal] = field(default_factory=dict)
    initial_state: Mapping[str, Decimal] = field(default_factory=dict)
    settle: float = 0.0
    linearization: Literal["auto", "twin", "derivatives", "differences", "identified"] = "auto"
    identification: Probe | None = None
    step: float | None = None

    @property
    def method(self) -> Literal["auto", "derivatives", "differences", "identified"]:
        """How the FMU is linearised where it is."""
        return "auto" if self.linearization == "twin" else self.linearization

    @property
    def by_twin(self) -> bool:
        """Whether the linear plant is the FMU's own twin: no code has to run for it."""
        return self.linearization == "twin" or (self.linearization == "auto" and self.archive.twin is not None)


@dataclass(frozen=True, slots=True)
class TransferPlant:
    """Polynomials, highest power of s first."""

    numerator: tuple[Decimal, ...]
    denominator: tuple[Decimal, ...]


@dataclass(frozen=True, slots=True)
class RootsPlant:
    """`gain ∏(s - z) / ∏(s - p)`."""

    zeros: tuple[Complex, ...]
    poles: tuple[Complex, ...]
    gain: Decimal


@dataclass(frozen=True, slots=True)
class StateSpacePlant:
    """`x' = A x + B u`, `y = C x + D u`, and further outputs by name (rows of C)."""

    A: tuple[tuple[Decimal, ...], ...]
    B: tuple[Decimal, ...]
    C: tuple[Decimal, ...]
    D: Decimal = Decimal(0)
    outputs: Mapping[str, tuple[Decimal, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ModalPlant:
    """`rigid/s² + Σ gain/(s² + 2ζωs + ω²)`; each mode is (ω [rad/s], ζ, gain)."""

    rigid: Decimal
    modes: tuple[tuple[Decimal, Decimal, Decimal], ...]


Source = FmuPlant | TransferPlant | RootsPlant | StateSpacePlant | ModalPlant


@dataclass(frozen=True, slots=True)
class Schedule:
    """Instants `times` [s], ascending from more than 0, and a plant's matrices there where they are not those at 0 (None: an FMU's own)."""

    times: tuple[Decimal, ...]
    A: tuple[tuple[tuple[Decimal, ...], ...], ...] | None = None
    B: tuple[tuple[Decimal, ...], ...] | None = None
    C: tuple[tuple[Decimal, ...], ...] | None = None


@dataclass(frozen=True, slots=True)
class Plant:
    """The plant, the names and units of its input and controlled output, and its input at the initial rest (u_0, input units).

    With a `schedule` it varies while it moves.
    """

    source: Source
    input: str
    output: str
    input_unit: str = ""
    output_unit: str = ""
    initial_input: Decimal = Decimal(0)
    schedule: Schedule | None = None

    @property
    def fmu(self) -> FmuPlant | None:
        """The FMU, if the plant is one."""
        return self.source if isinstance(self.source, FmuPlant) else None


@dataclass(frozen=True, slots=True)
class Maneuver:
    """Move the output by `displacement` (output units), from rest to rest; or from `initial_state`, deviations from it (`suite.starts`)."""

    displacement: Decimal
    initial_state: Mapping[str, Decimal] | tuple[Decimal, ...] | None = None
    given_scale: Decimal | None = None

    @property
    def scale(self) -> Decimal:
        """|Δ|, by which relative quantities are divided; what was given for it where the displacement is 0."""
        return self.given_scale or abs(self.displacement)


@dataclass(frozen=True, slots=True)
class Limits:
    """`lower ≤ u(t) ≤ upper`, absolute, input units; `∫_0^T |u - u_0| dt ≤ fuel` (input units · s); of a tail also (seconds after
    the move, fraction of the nearer limit's distance), and (shift as a fraction of its magnitude, residual as a fraction of the
    displacement) for zeros that may be elsewhere, by name. With a `sample_time` [s] the input is constant over each sample.
    No output named in `deflection` leaves its first rest value by more than that (output units). With a `rate` the input is continuous, its
    slope between these two (input units per second). With a `pulse_width` [s], or a largest number of `pulses`, it is that of thrusters: a
    limit, or the input at rest."""

    lower: Decimal
    upper: Decimal
    tail_length: tuple[Decimal, Decimal] | None = None
    zero_sensitivity: Mapping[str, tuple[Decimal, Decimal]] = field(default_factory=dict)
    sample_time: Decimal | None = None
    fuel: Decimal | None = None
    pulse_width: Decimal | None = None
    pulses: int | None = None
    deflection: Mapping[str, Decimal] = field(default_factory=dict)
    rate: tuple[Decimal, Decimal] | None = None


@dataclass(frozen=True, slots=True)
class ShaperRequest:
    """A shaper of this `kind`, as `request` says (no modes: the plant's own), its worst case over these `damping` ratios.

    With `follow`, a parameter, instants [s] after the start of the move and its values at them, the modes are those of the plant with the
    parameter's value of the moment. `reference` is what it shapes: "step", "rigid" (the fastest move of the rigid part), a command, or
    None: whichever of the two suits.
    """

    kind: str
    request: Request
    damping: tuple[float, float] | None = None
    reference: Literal["step", "rigid"] | Command | None = None
    follow: tuple[str, tuple[float, ...], tuple[Decimal, ...]] | None = None


@dataclass(frozen=True, slots=True)
class CancellingRequest:
    """A pole-zero cancelling filter of a form with so many delays (`relaxations.cancelling`), in front of the plant.

    `gains` bound its steps for this displacement (input units); `zeros` are the numbers of the plant's zeros that it cancels (None: all
    left of the imaginary axis). `instants` [s] are the delays, where they are given; with a `sample_time` [s] they are whole samples.
    """

    delays: int
    form: str
    gains: tuple[float, float] | None = None
    monotone: bool = False
    zeros: tuple[int, ...] | None = None
    instants: tuple[float, ...] | None = None
    sample_time: float | None = None


@dataclass(frozen=True, slots=True)
class CommandRequest:
    """What command is asked for: the fastest one with `robustness` further zeros at each flexible mode, the one that a `shaper` or
    a filter that is `cancelling` poles and zeros makes, or the one in `file` (`given`).

    `robustness` may count them mode by mode (`{"mode[2]": 1, "real[1]": 1}`), or be "box": every plant of the box may keep a residual of
    `tolerance`, a fraction of the displacement, and come to rest up to `final_tolerance` of it from the target (None: anywhere). With
    `tail` only the output has to rest. Of `type` 1 are pulses towards the target first, then pulses against it; 2 is any order. With a
    price `alpha` of fuel the command is that of the least `∫ (1 + alpha |u|) dt` (None: the fastest). The command begins `start` seconds
    after the beginning of a run.
    """

    kind: Literal["time-optimal", "fuel-efficient", "shaper", "pole-zero", "file"] = "time-optimal"
    robustness: int | Mapping[str, int] | Literal["box"] = 0
    tail: bool = False
    tolerance: Decimal | None = None
    final_tolerance: Decimal | None = None
    start: Decimal = Decimal(0)
    file: Path | None = None
    given: Command | None = None
    shaper: ShaperRequest | None = None
    cancelling: CancellingRequest | None = None
    type: int = 2
    alpha: Decimal | None = None


@dataclass(frozen=True, slots=True)
class Simulation:
    """How runs are simulated: communication `step`, window `observe` (None: chosen from the modes), `timeout` of one run; all [s].

    `interface` None is co-simulation where the FMU offers it.
    `confinement` limits the FMU's process: its memory, and the wall-clock time of a single step.
    """

    step: float | None = None
    observe: float | None = None
    timeout: float = 60.0
    seed: int = 0
    interface: Literal["co-simulation", "model-exchange"] | None = None
    confinement: Confinement = field(default_factory=Confinement)


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """A parameter that lies in [lower, upper] (its own `unit`), sampled at `samples` equally spaced values: an FMU's, or one that moves a
    root of the linear plant (`relaxations.robust.moved`)."""

    parameter: str
    lower: Decimal
    upper: Decimal
    samples: int
    unit: str = ""

    @property
    def moves_a_root(self) -> bool:
        """Whether it is a mode's frequency or damping, or a zero."""
        return Move.of(self.parameter) is not None

    @property
    def values(self) -> tuple[Fraction, ...]:
        """The samples, exact, both ends included; one sample is the middle."""
        lower, upper = Fraction(self.lower), Fraction(self.upper)
        if self.samples == 1:
            return ((lower + upper) / 2,)
        return tuple(lower + (upper - lower) * Fraction(i, self.samples - 1) for i in range(self.samples))


@dataclass(frozen=True, slots=True)
class Requirement:
    """`minimum ≤ quantity ≤ maximum`, limits included, for the nominal plant or the whole box. `unit` is empty for pure numbers."""

    id: str
    text: str
    quantity: Quantity
    minimum: float | None
    maximum: float | None
    unit: str
    scope: Literal["nominal", "box"]


@dataclass(frozen=True, slots=True)
class Conversion:
    """A value that was written with a unit: its place, the text, and the number in the unit that it is used in."""

    path: str
    written: str
    value: Decimal
    unit: str


@dataclass(frozen=True, slots=True)
class Study:
    """One study. `source` holds the file's bytes, `notes` what a reader should know about keys that change nothing.

    `conversions` are the values that were written with a unit, and the numbers that they are used as.
    """

    title: str
    file: Path
    source: bytes
    plant: Plant
    maneuver: Maneuver
    limits: Limits
    command: CommandRequest
    simulation: Simulation
    uncertainties: tuple[Uncertainty, ...]
    requirements: tuple[Requirement, ...]
    keep_logs: Literal["worst", "all"]
    notes: tuple[str, ...] = ()
    conversions: tuple[Conversion, ...] = ()

    @property
    def sha256(self) -> str:
        """The file's hash (hexadecimal)."""
        return hashlib.sha256(self.source).hexdigest()
