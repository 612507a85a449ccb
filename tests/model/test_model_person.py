import math

import numpy as np
import pytest

from ssm_service.errors import InputError
from ssm_service.model import DistanceModel, Robot, person

PARTS = [
    "left leg", "right leg", "torso", "head",
    "left upper arm", "left forearm", "right upper arm", "right forearm",
]  # fmt: skip


def parts(body):
    return {o.id.partition("/")[2]: o for o in body}


def ends(capsule):
    """Both cap centres, by the quaternion's own rotation of z, written apart."""
    x, y, z, w = capsule.quaternion_xyzw
    vector = np.array([x, y, z])
    up = np.array([0.0, 0.0, 1.0])
    axis = up + 2.0 * np.cross(vector, np.cross(vector, up) + w * up)
    return np.array(capsule.position) - 0.5 * capsule.size[1] * axis, np.array(
        capsule.position
    ) + 0.5 * capsule.size[1] * axis


def tips(capsule):
    start, end = ends(capsule)
    return end + capsule.size[0] * (end - start) / np.linalg.norm(end - start)


def test_a_person_is_eight_capsules_from_the_floor_to_the_height():
    body = person([1.0, 2.0, -0.75], 0.3, height=1.8)
    assert [o.id for o in body] == [f"person/{part}" for part in PARTS]
    assert {o.shape for o in body} == {"capsule"}
    lowest = min(min(p[2] for p in ends(o)) - o.size[0] for o in body)
    highest = max(max(p[2] for p in ends(o)) + o.size[0] for o in body)
    assert lowest == pytest.approx(-0.75, abs=1e-12)
    assert highest == pytest.approx(-0.75 + 1.8, abs=1e-12)


def test_segments_join_and_have_winters_lengths():
    for aim in ({}, {"reach_to": [0.3, 0.1, 1.2]}, {"reach_along": [1.0, 0.2, -0.5]}):
        body = parts(person([0, 0, 0], 0.0, height=2.0, **aim))
        for side in ("left", "right"):
            upper, forearm = body[f"{side} upper arm"], body[f"{side} forearm"]
            assert upper.size[1] == pytest.approx(2.0 * 0.186)
            assert forearm.size[1] + forearm.size[0] == pytest.approx(2.0 * (0.146 + 0.108))
            assert ends(upper)[1] == pytest.approx(ends(forearm)[0], abs=1e-9)
            assert ends(upper)[0] == pytest.approx(
                [0.0, (1 if side == "left" else -1) * 2.0 * 0.129, 2.0 * 0.818]
            )


@pytest.mark.parametrize("heading", [0.0, 1.0, math.pi, -2.0])
def test_reaches_a_point_with_the_finger_tips(heading):
    rng = np.random.default_rng(1)
    feet, height = np.array([0.4, -0.2, -0.7]), 1.7
    for arm in ("left", "right"):
        hanging = parts(person(feet, heading, height=height))
        shoulder = ends(hanging[f"{arm} upper arm"])[0]
        for _ in range(20):
            direction = rng.normal(size=3)
            direction /= np.linalg.norm(direction)
            point = shoulder + rng.uniform(0.15, 0.74) * direction
            body = parts(person(feet, heading, height=height, reach_to=point, arm=arm))
            assert tips(body[f"{arm} forearm"]) == pytest.approx(point, abs=1e-9)
            elbow = ends(body[f"{arm} forearm"])[0]
            on_line = shoulder + ((elbow - shoulder) @ direction) * direction
            assert elbow[2] <= on_line[2] + 1e-9  # it hangs
            for part in PARTS:
                if not part.startswith(arm) or part.endswith("leg"):
                    assert body[part] == hanging[part]
            far = parts(person(feet, heading, height=height, reach_to=shoulder + 3.0 * direction, arm=arm))
            along = parts(person(feet, heading, height=height, reach_along=0.1 * direction, arm=arm))
            stretched = shoulder + height * (0.186 + 0.254) * direction
            assert tips(far[f"{arm} forearm"]) == pytest.approx(stretched, abs=1e-9)
            assert tips(along[f"{arm} forearm"]) == pytest.approx(stretched, abs=1e-9)


def test_points_too_near_and_straight_up_or_down_are_reached_as_well_as_can_be():
    shoulder = np.array([0.0, -0.129, 0.818]) * 1.75
    for point in (
        shoulder,
        shoulder + 0.5 * np.eye(3)[2],
        shoulder - 0.5 * np.eye(3)[2],
        shoulder + np.array([1e-12, 0.0, 0.02]),
    ):
        body = parts(person([0, 0, 0], 0.0, reach_to=point))
        least = 1.75 * (0.254 - 0.186)
        gap = np.linalg.norm(tips(body["right forearm"]) - point)
        assert gap <= max(0.0, least - np.linalg.norm(point - shoulder)) + 1e-9


def test_turning_and_moving_the_person_turns_and_moves_every_capsule():
    plain, placed = (
        person([0, 0, 0], 0.0),
        person([0.5, -0.3, 0.2], 0.8, velocity=(1.0, 0.0, 0.0), name="ann"),
    )
    turn = np.array([[math.cos(0.8), -math.sin(0.8), 0], [math.sin(0.8), math.cos(0.8), 0], [0, 0, 1]])
    for a, b in zip(plain, placed, strict=True):
        assert b.id == a.id.replace("person", "ann")
        assert b.size == pytest.approx(a.size)
        assert b.velocity == (1.0, 0.0, 0.0)
        for p, q in zip(ends(a), ends(b), strict=True):
            assert turn @ p + [0.5, -0.3, 0.2] == pytest.approx(q, abs=1e-12)


def test_left_is_left_of_where_the_person_looks():
    body = parts(person([0, 0, 0], math.pi / 2))  # looks along y: left is −x
    assert body["left leg"].position[0] < 0.0 < body["right leg"].position[0]


def test_a_hand_at_a_place_is_that_near_by_coal():
    robot = Robot.load("ur3")
    distances, place = DistanceModel(robot), np.array([0.6, 0.0, 0.2])
    position = np.array([0.0, -2.0, 1.0, 0.0, 0.0, 0.0])
    body = person([1.1, 0.0, -0.75], math.pi, reach_to=place)
    distances.set_obstacles(body)
    nearest = distances.nearest(position)
    assert nearest is not None
    hand = parts(body)["right forearm"]
    assert tips(hand) == pytest.approx(place, abs=1e-9)
    distances.set_obstacles([hand])
    alone = distances.nearest(position)
    assert alone is not None
    assert nearest.distance <= alone.distance


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"position": [0, 0]}, "wrong_length"),
        ({"position": [0, 0, math.nan]}, "not_finite"),
        ({"position": "here"}, "wrong_type"),
        ({"heading": math.inf}, "not_finite"),
        ({"height": 0.1}, "out_of_range"),
        ({"height": math.nan}, "out_of_range"),
        ({"arm": "third"}, "unknown_arm"),
        ({"reach_to": [1, 2]}, "wrong_length"),
        ({"reach_along": [0, 0, 0]}, "out_of_range"),
        ({"reach_to": [1, 0, 0], "reach_along": [1, 0, 0]}, "out_of_range"),
        ({"velocity": (math.nan, 0, 0)}, "not_finite"),
    ],
)
def test_bad_arguments_are_refused(change, cause):
    with pytest.raises(InputError) as caught:
        person(**{"position": [0, 0, 0], "heading": 0.0, **change})
    assert caught.value.cause == cause
