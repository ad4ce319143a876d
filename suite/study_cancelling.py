"""`command.kind = "pole-zero"`: from the keys as written to the filter as meant."""

from __future__ import annotations

from relaxations.cancelling.forms import DEFAULT, Form
from relaxations.errors import ShaperError
from suite import schema
from suite.errors import Mistake
from suite.study import CancellingRequest


def understand_cancelling(written: schema.Command, wrong: list[Mistake]) -> CancellingRequest | None:
    """What the keys mean, or None and what is wrong with them."""
    if written.delays is None:
        return None
    try:
        Form.named(written.form or DEFAULT, written.delays)
    except ShaperError as problem:
        wrong.append(Mistake("command.form", written.form, str(problem)))
        return None
    return CancellingRequest(
        written.delays,
        written.form or DEFAULT,
        None if written.gains is None else (float(written.gains[0]), float(written.gains[1])),
        bool(written.monotone),
        _zeros(written),
        None if written.instants is None else tuple(map(float, written.instants)),
        None if written.sample_time is None else float(written.sample_time),
    )


def _zeros(written: schema.Command) -> tuple[int, ...] | None:
    if written.tail is False:
        return ()
    return None if written.zeros is None else tuple(int(name.removeprefix("zero[").removesuffix("]")) for name in written.zeros)
