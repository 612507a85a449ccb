"""The reference page of scenario files is complete and up to date."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from ssm_service.config.reference import COLUMNS
from ssm_service.simulation import scenarios_directory
from ssm_service.simulation.reference import reference


def rows() -> dict[str, dict[str, str]]:
    """Return the rows of the page by key path, as cells by column."""
    found = {}
    for line in reference().splitlines():
        if line.startswith("| `"):
            cells = [cell.strip() for cell in line.strip("|").split(" | ")]
            found[cells[0].strip("`")] = dict(zip(COLUMNS, cells, strict=True))
    return found


def keys(value: object, prefix: str = "") -> list[str]:
    """Return the key paths of all values of a document that are not tables."""
    if isinstance(value, dict):
        return [key for name, inner in value.items() for key in keys(inner, f"{prefix}.{name}".strip("."))]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [key for inner in value for key in keys(inner, f"{prefix}[]")]
    return [prefix]


def test_the_page_beside_the_scenarios_is_up_to_date() -> None:
    page = scenarios_directory() / "REFERENCE.md"
    if page.read_text(encoding="utf-8") != reference():
        pytest.fail(
            "the page is out of date; write it anew with:\n  python -m ssm_service.simulation.reference "
            "> ssm_service/simulation/scenarios/REFERENCE.md"
        )


def test_the_module_prints_the_page() -> None:
    command = [sys.executable, "-m", "ssm_service.simulation.reference"]
    done = subprocess.run(command, capture_output=True, check=True, timeout=60)
    assert done.stdout.decode() == reference()
    assert not done.stderr


def test_every_key_has_a_meaning_and_a_type() -> None:
    for key, cells in rows().items():
        assert all(cells.values()), key
        assert len(cells["meaning"]) > 5, key


def test_known_rows() -> None:
    duration = rows()["duration_s"]
    assert (duration["type"], duration["unit"], duration["bounds"]) == ("number", "s", "> 0 and ≤ 3600")
    assert duration["default"] == "**required**"
    assert rows()["obstacles[].at_the_end"]["default"] == '`"loop"`'
    assert rows()["obstacles[].shapes[].offset_m"]["default"] == "`[0.0, 0.0, 0.0]`"
    assert "## `[[obstacles.shapes]]`" in reference()


@pytest.mark.parametrize("path", sorted(scenarios_directory().glob("*.toml")), ids=lambda path: path.stem)
def test_every_key_of_a_shipped_scenario_is_on_the_page(path: Path) -> None:
    pattern = "|".join(re.escape(key).replace("NAME", r"[^.]+") for key in rows())
    for key in keys(tomllib.loads(path.read_text(encoding="utf-8"))):
        assert re.fullmatch(pattern, key), key
