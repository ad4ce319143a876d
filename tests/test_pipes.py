"""Pipes to a child: frames in any pieces, floods that block nobody, requests larger than a pipe, garbage."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from fmus.isolated import frame, read_frame
from fmus.pipes import CHUNK, OUTPUT_LIMIT, Broken, Pipes


@dataclass
class Ends:
    """Ours, and the child's ends of the same pipes."""

    pipes: Pipes
    requests: int
    answers: int
    printed: int


@pytest.fixture
def ends() -> Iterator[Ends]:
    (requests, our_requests), (our_answers, answers), (our_printed, printed) = os.pipe(), os.pipe(), os.pipe()
    yield Ends(Pipes(our_requests, our_answers, our_printed), requests, answers, printed)
    for descriptor in (requests, our_requests, our_answers, answers, our_printed, printed):
        try:
            os.close(descriptor)
        except OSError:
            continue  # the test has closed it


def test_frames_come_in_any_pieces(ends: Ends) -> None:
    data = frame({"message": [0.0, "ok", "ä"]}) + frame({"status": "FINISHED"}, b"raw")
    seen = []
    for byte in data:
        os.write(ends.answers, bytes([byte]))
        seen += ends.pipes.messages(1.0)
    assert seen == [{"message": [0.0, "ok", "ä"]}, {"status": "FINISHED"}]
    assert list(ends.pipes.messages(0.0)) == []
    os.close(ends.answers)
    assert list(ends.pipes.messages(1.0)) == []
    assert ends.pipes.ended


@pytest.mark.parametrize("garbage", [b"\xff" * 8, b"\0\0\0\2\0\0\0\0no", b"\0\0\0\1\0\0\0\0{", b"\0\0\0\2\0\0\0\0[]"])
def test_garbage_is_told_apart(ends: Ends, garbage: bytes) -> None:
    os.write(ends.answers, garbage)
    with pytest.raises(Broken):
        list(ends.pipes.messages(1.0))


def test_a_request_larger_than_a_pipe_goes_while_answers_come(ends: Ends) -> None:
    raw, got = os.urandom(20 * CHUNK), []

    def child() -> None:
        with os.fdopen(os.dup(ends.requests), "rb") as stream:
            got.append(read_frame(stream))
        os.write(ends.answers, frame({"status": "FINISHED"}))

    thread = threading.Thread(target=child)
    thread.start()
    ends.pipes.send(frame({"kind": "run"}, raw))
    answers: list[object] = []
    while not answers:
        answers += ends.pipes.messages(1.0)
    thread.join()
    assert got == [({"kind": "run"}, raw)]


def test_a_flood_blocks_nobody_and_its_beginning_is_kept(ends: Ends) -> None:
    def child() -> None:
        for _ in range(200):
            os.write(ends.printed, b"x" * CHUNK)
        os.write(ends.answers, frame({"status": "FINISHED"}))

    ends.pipes.send(b"")
    thread = threading.Thread(target=child)
    thread.start()
    answers: list[object] = []
    while not answers:
        answers += ends.pipes.messages(1.0)
    thread.join()
    text = ends.pipes.printed()
    assert text.startswith("x" * OUTPUT_LIMIT)
    assert text.endswith("(more was printed, and dropped)")
    os.write(ends.printed, b"of no run")
    ends.pipes.send(b"")
    os.write(ends.printed, "of the next, ü".encode())
    assert ends.pipes.printed() == "of the next, ü"


def test_a_child_that_is_gone_ends_the_request(ends: Ends) -> None:
    os.close(ends.requests)
    os.close(ends.answers)
    ends.pipes.send(b"x" * 4 * CHUNK)
    assert list(ends.pipes.messages(1.0)) == []
    assert ends.pipes.ended
