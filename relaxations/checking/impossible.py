"""Tasks that no time suffices for, where the rest input lies *on* a limit: exact criteria, since balls cannot decide an equality.

face       A plant with at least a double pole at the origin needs ∫u = 0 (deviations). If the input may leave its rest value to one side
           only, u vanishes almost everywhere, and nothing moves.
remainder  For a real stable pole a, rest at u_ss asks ∫_0^T e^{as} u ds = u_ss ∫_0^∞ e^{as} ds. If u_ss is itself the limit, the left side
           is at most (for a lower limit: at least) u_ss ∫_0^T e^{as} ds, which is less (more) for every finite T.

Both are equation 2 of docs/theory.md with a costate of one term; both speak of state rest, or of plants without stable zeros.
"""

from __future__ import annotations

from collections.abc import Sequence

from relaxations.checking.balls import Inconclusive, Plant
from relaxations.checking.reading import LowerWitness, Malformed, Task


def prove(task: Task, plants: Sequence[Plant], form: str, witness: LowerWitness | None) -> None:
    """Prove that no admissible command reaches the target in any time; raises `Malformed` or `Inconclusive`."""
    if witness is not None:
        raise Malformed("an impossible task needs no witness: its criterion is exact")
    if any(plant.zeros for plant in plants):
        raise Inconclusive("with a free tail the criterion does not apply")
    lower, upper = task.lower_limit - task.initial_input, task.upper_limit - task.initial_input
    for plant in plants:
        if form == "face":
            rigid = max((root.multiplicity for root in plant.roots if root.at_origin), default=0)
            if rigid >= 2 and (lower == 0 or upper == 0):
                return
        elif (
            plant.rest_input in (lower, upper)
            and plant.rest_input != 0
            and any(not root.flexible and root.value.real < 0 for root in plant.roots)
        ):
            return
    raise Inconclusive(f"the criterion '{form}' does not apply to this task")
