"""The reference page of robot files is complete and up to date."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib

import pytest

from ssm_service.config import robots_directory
from ssm_service.config.reference import COLUMNS, reference


def rows() -> dict[str, dict[str, str]]:
    """Return the rows of the page by key path, as cells by column; ``{a,b}`` spelled out."""
    result = {}
    for line in reference().splitlines():
        if not line.startswith("| `"):
            continue
        cells = dict(zip(COLUMNS, (cell.strip() for cell in line.strip("|").split(" | ")), strict=True))
        key = cells["key"].strip("`")
        match = re.search(r"\{(.*)\}", key)
        for word in match[1].split(",") if match else [""]:
            result[key.replace(match[0], word) if match else key] = cells
    return result


def test_the_page_in_robots_is_up_to_date():
    page = (robots_directory() / "REFERENCE.md").read_text(encoding="utf-8")
    if page != reference():
        pytest.fail(
            "robots/REFERENCE.md is out of date; write it anew with:\n"
            "  python -m ssm_service.config.reference > robots/REFERENCE.md"
        )


def test_the_module_prints_the_page():
    command = [sys.executable, "-m", "ssm_service.config.reference"]
    done = subprocess.run(command, capture_output=True, check=True, timeout=60)
    assert done.stdout.decode() == reference()


def test_every_key_has_a_meaning_and_a_type():
    for key, cells in rows().items():
        assert all(cells.values()), key
        assert len(cells["meaning"]) > 5, key


def test_known_rows():
    radius = rows()["rings[].radius_m"]
    assert (radius["type"], radius["unit"], radius["bounds"]) == ("number", "m", "> 0 and ≤ 2")
    assert radius["default"] == "**required**"
    assert rows()["profiles.NAME.red.distance_m"] == rows()["profiles.NAME.yellow.distance_m"]
    assert rows()["sources.obstacles"]["default"].startswith("`{ required = false, timeout_s = 0.25, ")
    controllers = "`clik-1` or `clik-2` or `clik-3` or `field` or `field3d` or `filter`"
    assert rows()["motion.controller"]["type"] == controllers


@pytest.mark.parametrize("path", sorted(robots_directory().glob("*.toml")), ids=lambda path: path.stem)
def test_every_key_of_a_shipped_robot_is_on_the_page(path):
    pattern = "|".join(re.escape(key).replace("NAME", r"[^.]+") for key in rows())
    for key in keys(tomllib.loads(path.read_text(encoding="utf-8")), ""):
        assert re.fullmatch(pattern, key), key


def keys(value: object, prefix: str) -> list[str]:
    """Return the key paths of all values of a document that are not tables."""
    if isinstance(value, dict):
        return [key for name, inner in value.items() for key in keys(inner, f"{prefix}.{name}".strip("."))]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [key for inner in value for key in keys(inner, f"{prefix}[]")]
    return [prefix]
