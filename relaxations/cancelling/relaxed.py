"""What any number of delays can reach: steps on every delay of a fine grid, and a tail with free coefficients, within bounds.

The equations and bounds are linear in both, so that at each duration this is a linear program; one that is possible stays so when the
filter takes longer, for it may wait. What it finds is a filter. That none is shorter at all is said by `relaxations.proofs.minimum_time`
where levels are bounded, and by `relaxations.cancelling.monotone` for answers that never turn back.
"""

from __future__ import annotations

import numpy as np

from relaxations.cancelling.conditions import Conditions
from relaxations.cancelling.designs import natural_time, solved_at
from relaxations.cancelling.forms import Form
from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.structures import Bounds, Structure
from relaxations.errors import ImpossibleShaperError

LONGEST = 4.0  # times the plant's own time
CLOSE = 1e-9  # relative: of the duration's bracket


def any_delays(conditions: Conditions, bounds: Bounds, cells: int = 200) -> Prefilter:
    """The shortest filter with its delays on a grid of `cells` equal parts of its duration; most of its steps are 0.

    Raises `ImpossibleShaperError` if there is none up to four times the plant's own time.
    """
    structure = Structure(conditions, Form(cells, (cells,), step=True, free=True), bounds)
    if structure.contradiction is not None:
        raise ImpossibleShaperError(structure.contradiction)
    grid = np.linspace(0.0, 1.0, cells + 1)
    low, high = 0.0, LONGEST * natural_time(structure)
    best = solved_at(structure, grid * high)
    if best is None:
        raise ImpossibleShaperError(f"no filter with {cells} delays was found up to {high:.6g} s within the bounds")
    while high - low > CLOSE * high:
        middle = (low + high) / 2.0
        found = solved_at(structure, grid * middle)
        best, low, high = (best, middle, high) if found is None else (found, low, middle)
    return structure.filter(best.delays, best.unknowns)
