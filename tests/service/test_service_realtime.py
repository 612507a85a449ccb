"""What the service asks of the C library's allocator, seen in what the allocator says of itself."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import ctypes, os, sys, tempfile, threading
from ssm_service.service.realtime import few_arenas
if sys.argv[1] == "few":
    few_arenas()
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
together = threading.Barrier(17)

def use():
    for _ in range(50):
        libc.malloc(ctypes.c_size_t(5000))
    together.wait()
    together.wait()

for _ in range(16):
    threading.Thread(target=use, daemon=True).start()
together.wait()
libc.fopen.restype = ctypes.c_void_p
path = tempfile.mktemp()
file = ctypes.c_void_p(libc.fopen(path.encode(), b"w"))
libc.malloc_info(0, file)
libc.fclose(file)
print(open(path).read().count("<heap nr="))
os.unlink(path)
together.wait()
"""


def test_many_threads_share_two_arenas():
    arenas = {
        how: int(subprocess.run([sys.executable, "-c", PROGRAM, how], check=True, capture_output=True).stdout)
        for how in ("few", "usual")
    }
    assert arenas["few"] <= 2 < arenas["usual"]
