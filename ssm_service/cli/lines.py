"""Lines of a stream of any size, in bounded memory."""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from ..errors import ConfigError

AHEAD = 256
"""Lines that may wait between the reader and the one who answers."""


class Line(NamedTuple):
    """One line that is not blank.

    Attributes:
        number: Its number, from 1, blank lines counted.
        data: Its bytes without the end of the line.
        too_long: Whether ``data`` is only its beginning.
    """

    number: int
    data: bytes
    too_long: bool


@contextlib.contextmanager
def opened(file: Path | None) -> Iterator[BinaryIO]:
    """Open a file for reading; stdin where there is none, or where it is ``-``.

    Raises:
        ConfigError: It cannot be read.
    """
    if file is None or str(file) == "-":
        # A handle of our own: Python would wait for a reading thread that holds its stdin when it ends.
        with open(os.dup(sys.stdin.fileno()), "rb") as stream:
            yield stream
        return
    try:
        stream = file.open("rb")
    except OSError as error:
        raise ConfigError(file, "", error.strerror or str(error), "a readable file of JSON lines") from error
    with stream:
        yield stream


def read_lines(stream: BinaryIO, limit: int) -> Iterator[Line]:
    """Yield the lines that are not blank; of one longer than ``limit`` [bytes] only the beginning is kept."""
    number = 0
    while data := stream.readline(limit + 1):
        number += 1
        too_long = len(data) > limit and not data.endswith(b"\n")
        rest = data
        while too_long and rest and not rest.endswith(b"\n"):
            rest = stream.readline(limit)
        if data.strip():
            yield Line(number, data.rstrip(b"\r\n"), too_long)


def read_chunks(stream: BinaryIO, limit: int, most: int) -> Iterator[list[Line]]:
    """Yield lines in chunks: what is there already, at most ``most``, and never waiting to fill one.

    So a program that sends one line and waits for its answer gets it.
    """
    waiting: queue.Queue[Line | None] = queue.Queue(AHEAD)

    def read() -> None:
        try:
            for line in read_lines(stream, limit):
                waiting.put(line)
        finally:
            waiting.put(None)

    threading.Thread(target=read, daemon=True).start()
    ended = False
    while not ended:
        chunk: list[Line] = []
        while len(chunk) < most and (not chunk or not waiting.empty()):
            line = waiting.get()
            if line is None:
                ended = True
                break
            chunk.append(line)
        if chunk:
            yield chunk
