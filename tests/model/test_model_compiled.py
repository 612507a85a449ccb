"""Compiled code on disk is never older than any source that it was made of."""

import shutil
import subprocess
import sys
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "ssm_service"

CALLED = """
from .compiled import compiled

@compiled
def half(x):
    return x / {divisor}
"""

CALLER = """
from .compiled import compiled
from .called import half

@compiled
def quarter(x):
    return half(half(x))
"""


def run(folder: Path) -> tuple[float, int]:
    code = "from pkg.model.caller import quarter\nprint(quarter(8.0), sum(quarter.stats.cache_hits.values()))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=100, check=True
    )
    value, hits = done.stdout.split()
    return float(value), int(hits)


def test_a_change_in_a_called_file_compiles_its_callers_anew(tmp_path):
    room = tmp_path / "pkg" / "model"
    room.mkdir(parents=True)
    (tmp_path / "pkg" / "__init__.py").write_text("")
    (room / "__init__.py").write_text("")
    shutil.copy(PACKAGE / "model" / "compiled.py", room)
    (room / "caller.py").write_text(CALLER)
    (room / "called.py").write_text(CALLED.format(divisor="2.0"))
    assert run(tmp_path) == (2.0, 0)
    assert run(tmp_path) == (2.0, 1)
    (room / "called.py").write_text(CALLED.format(divisor="4.0"))
    assert run(tmp_path) == (0.5, 0)


def test_without_a_place_for_it_everything_is_compiled_in_the_process(tmp_path, monkeypatch):
    room = tmp_path / "pkg" / "model"
    room.mkdir(parents=True)
    for folder in (tmp_path / "pkg", room):
        (folder / "__init__.py").write_text("")
    shutil.copy(PACKAGE / "model" / "compiled.py", room)
    (room / "caller.py").write_text(CALLER)
    (room / "called.py").write_text(CALLED.format(divisor="2.0"))
    # A file where the folder would be: nobody, root included, can write below it.
    (room / "__pycache__").write_text("")
    blocked = tmp_path / "home"
    blocked.write_text("")
    monkeypatch.setenv("HOME", str(blocked))
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    assert run(tmp_path) == (2.0, 0)
    assert run(tmp_path) == (2.0, 0)
