"""``ssm evaluate``: one line in, one line out, whatever the line."""

from __future__ import annotations

import itertools
import json
import math
import subprocess

import pytest
from cli_kit import COMMAND

POSITION = [0.3, -1.2, 1.4, 0.0, 0.0, 0.0]
JOINTS = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
QUESTION = {
    "position": POSITION,
    "velocity": [0.1, -0.1, 0.2, 0.0, 0.0, 0.0],
    "ranges": [None, 0.3, 0.35, None, None, None, None, None],
    "obstacles": [{"id": "ball", "shape": "sphere", "size": [0.05], "position": [0.5, 0.2, 0.4]}],
    "target": {"kind": "position", "value": [0.3, 0.1, 0.3]},
}


def lines(*values: object) -> str:
    return "".join(f"{value if isinstance(value, str) else json.dumps(value)}\n" for value in values)


def answers(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def test_an_answer_has_the_fields_of_the_contract(ssm):
    done = ssm("evaluate", stdin=lines(QUESTION))
    assert (done.returncode, done.stderr) == (0, "")
    (answer,) = answers(done.stdout)
    assert set(answer) == {
        "zone", "distance", "speed_limit", "speed_scaling", "reasons", "pairs", "estimates", "frames",
        "jacobian", "command",
    }  # fmt: skip
    assert len(answer["pairs"]) == 8
    assert answer["distance"] == min(0.3, *(pair["distance"] for pair in answer["pairs"]))
    assert len(answer["frames"]["sensors"]) == 8
    assert [len(row) for row in answer["jacobian"]] == [3, 3, 3]
    assert all(
        abs(v) <= limit for v, limit in zip(answer["command"]["velocity"], answer["speed_limit"], strict=True)
    )


EDGES = [
    (0.0, "stop", 0.0),
    (math.ulp(0.0), "red", 0.18),
    (0.1775, "red", 0.18),
    (math.nextafter(0.1775, 1.0), "yellow", 0.24),
    (0.355, "yellow", 0.24),
    (math.nextafter(0.355, 1.0), "green", None),
    (None, "green", None),
]


def test_an_edge_belongs_to_the_nearer_zone(ssm):
    questions = [{"position": POSITION, "ranges": [reading] + [None] * 7} for reading, _, _ in EDGES]
    done = ssm("evaluate", stdin=lines(*questions))
    for answer, (reading, zone, speed) in zip(answers(done.stdout), EDGES, strict=True):
        assert answer["zone"] == zone
        assert answer["distance"] == reading
        if speed is not None:
            assert set(answer["speed_limit"]) == {speed}


def test_without_any_perception_it_waits(ssm):
    (answer,) = answers(ssm("evaluate", stdin=lines({"position": POSITION})).stdout)
    assert answer["zone"] == "stop"
    assert answer["reasons"] == ["waiting:ranges"]


def test_all_720_orders_of_the_joints_give_the_same_bytes(ssm):
    questions = []
    for order in itertools.permutations(range(6)):
        named = {"name": [f"{JOINTS[i]}_joint" for i in order], "position": [POSITION[i] for i in order]}
        named["velocity"] = [QUESTION["velocity"][i] for i in order]
        questions.append({**QUESTION, **named})
    done = ssm("evaluate", stdin=lines(QUESTION, *questions))
    assert done.returncode == 0
    found = done.stdout.splitlines()
    assert len(found) == 721
    assert len(set(found)) == 1


BAD = {
    "no json": "{",
    "no object": "[1, 2]",
    "empty object": "{}",
    "not finite": '{"position": [NaN, 0, 0, 0, 0, 0]}',
    "too short": '{"position": [0, 0]}',
    "unknown field": '{"position": [0, 0, 0, 0, 0, 0], "rangs": []}',
    "unknown shape": lines(
        {
            "position": POSITION,
            "obstacles": [{"id": "a", "shape": "cube", "size": [1], "position": [1, 1, 1]}],
        }
    ).strip(),
    "repeated id": lines({"position": POSITION, "obstacles": QUESTION["obstacles"] * 2}).strip(),
    "out of range": lines({"position": POSITION, "ranges": [-1] + [None] * 7}).strip(),
    "no utf-8": '{"position": "\udcff"}',
}


def test_a_bad_line_is_answered_on_its_line_and_the_others_as_ever(ssm, tmp_path):
    good = ssm("evaluate", stdin=lines(QUESTION)).stdout
    text = "".join(f"{bad}\n\n{json.dumps(QUESTION)}\n" for bad in BAD.values())
    file = tmp_path / "questions.jsonl"
    file.write_bytes(text.encode("utf-8", "surrogateescape"))
    done = ssm("evaluate", str(file))
    assert done.returncode == 1
    found = done.stdout.splitlines(keepends=True)
    assert len(found) == 2 * len(BAD)
    assert set(found[1::2]) == {good}
    for index, name in enumerate(BAD):
        assert list(json.loads(found[2 * index])) == ["error"], name
    said = done.stderr.splitlines()
    assert [line.partition(":")[0] for line in said] == [f"line {3 * i + 1}" for i in range(len(BAD))]


def test_a_line_of_any_length_is_refused_without_being_kept(ssm):
    text = '{"position": [' + "0," * 3_000_000 + "]}\n" + lines(QUESTION)
    done = ssm("evaluate", stdin=text)
    assert done.returncode == 1
    first, second = answers(done.stdout)
    assert "at most 4194304 bytes" in first["error"]
    assert second["zone"]
    assert len(done.stderr) < 300


@pytest.mark.parametrize("remote", [False, True])
def test_an_answer_comes_before_the_input_ends(service, remote):
    where = ["--remote", "--connect", service] if remote else []
    process = subprocess.Popen(
        [*COMMAND, "evaluate", *where], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    with process:
        for _ in range(3):
            process.stdin.write(lines(QUESTION))
            process.stdin.flush()
            assert json.loads(process.stdout.readline())["pairs"]
        process.stdin.close()
    assert process.returncode == 0


def test_a_reader_that_leaves_causes_no_words():
    process = subprocess.Popen(
        [*COMMAND, "evaluate"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.close()
    _, said = process.communicate(lines(*[QUESTION] * 200), timeout=60)
    assert process.returncode == 1
    assert said == ""


def test_a_running_service_gives_the_same_answers_in_the_same_order(ssm, service):
    moved = [{**QUESTION, "position": [0.1 * i, *POSITION[1:]]} for i in range(40)]
    text = lines(*moved[:20], BAD["too short"], BAD["no json"], *moved[20:])
    here = ssm("evaluate", stdin=text)
    there = ssm("evaluate", "--remote", "--connect", service, stdin=text)
    assert there.returncode == here.returncode == 1
    assert answers(there.stdout) == answers(here.stdout)
    assert there.stderr == here.stderr
