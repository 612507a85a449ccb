"""Several threads may read files of a kind that nobody has read before: the library below must not crash."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import sys, threading
from pathlib import Path
from typing import Annotated
import msgspec
from ssm_service.config import load_toml

sys.setswitchinterval(1e-6)
path = Path(sys.argv[1])
path.write_text("a = 1.0")

def kind(depth):
    below = [("below", kind(depth - 1) | None, None)] if depth else []
    number = Annotated[float, msgspec.Meta(gt=0.0)]
    fields = [("a", number, 1.0), ("b", list[number] | None, None), ("c", dict[str, number] | None, None)]
    return msgspec.defstruct(f"Kind{depth}", [*fields, *below], frozen=True, kw_only=True)

for _ in range(120):
    new, together = kind(6), threading.Barrier(4)

    def read(new=new, together=together):
        together.wait()
        load_toml(path, new)

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
"""


def test_threads_that_read_a_new_kind_of_file_at_once_do_not_crash(tmp_path):
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "file.toml")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120.0)
    assert (done.returncode, done.stderr) == (0, "")
