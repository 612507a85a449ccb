"""The reference page of all scenario-file keys, written from ``schema``.

``python -m ssm_service.simulation.reference`` prints it; ``scenarios/REFERENCE.md`` holds it.
"""

from __future__ import annotations

import sys

from ..config.reference import reference as file_reference
from .schema import ScenarioFile

INTRODUCTION = """\
# Scenario files: every key

A scenario file is one TOML file that says what happens round the simulated robot and what the arm is told
to do meanwhile: `ssm sim --scenario my_scene.toml`, or a name from beside this page; `static.toml` is a
short, real one. It is read strictly. An unknown key, a wrong type or a value out of bounds stops the program
with a message that names the file, the key, what was found and what is allowed. Numbers are finite; a whole
number may stand wherever a number is asked for. Units are SI; positions are in the robot's base frame.

A robot that has none of the joints named in `start` may run the scenario, too: it starts at rest and sways
one joint gently back and forth, for the targets may be out of its reach, and the obstacles stay where they
are. Where it has some of these joints but not all, the file is refused.

In the keys below, `NAME` is the name of a joint, and `obstacles[]` is each entry of the array `obstacles`,
one `[[obstacles]]` table in the file for each; so are `targets[]`, `shapes[]` and `path[]`.

<!-- Written by `python -m ssm_service.simulation.reference > ssm_service/simulation/scenarios/REFERENCE.md`
     from ssm_service/simulation/schema.py. Change the schema, not this page. -->
"""


def reference() -> str:
    """Return the page as Markdown, one section for each kind of table."""
    return file_reference(ScenarioFile, INTRODUCTION)


if __name__ == "__main__":
    sys.stdout.write(reference())
