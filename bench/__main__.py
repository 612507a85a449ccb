"""Lists the benchmarks: every module here that has a ``main``, with the first line of its docstring."""

from __future__ import annotations

import argparse
import ast
import json
from pathlib import Path


def benchmarks() -> dict[str, str]:
    """Return each benchmark's name and what it says of itself, without importing it."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in tree.body):
            found[path.stem] = (ast.get_docstring(tree) or "").partition("\n")[0]
    return found


def _list() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench", description="Lists the benchmarks.")
    parser.add_argument("--json", action="store_true", help="machine-readable, on stdout")
    found = benchmarks()
    if parser.parse_args().json:
        print(json.dumps(found))
        return
    width = max(map(len, found))
    for name, text in found.items():
        print(f"python -m bench.{name:<{width}}  {text}")


if __name__ == "__main__":
    _list()
