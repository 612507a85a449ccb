"""Every field of what is sent comes from where it is said to come from: each value occurs once."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from ssm_service.model import ClosestPair, Kinematics, Robot
from ssm_service.monitor import Comparison, Decision, Evaluation, Nearest, SourceReport
from ssm_service.monitor.evaluate import EvaluatedPair
from ssm_service.monitor.separated import PairTable, Separated
from ssm_service.perception import Estimate, RingEstimates
from ssm_service.safety import (
    ReactionTime,
    SeparationTerms,
    SourceState,
    SourceStatus,
    StoppingLevels,
    Zone,
)
from ssm_service.wire import (
    command_message,
    encoding_of,
    evaluate_message,
    frames_message,
    json_schemas,
    names_another,
    question_from,
    separation_message,
    separation_pairs,
    zone_message,
)
from ssm_service.wire import messages as m
from ssm_service.wire.convert import optional_readings, vector
from ssm_service.wire.keys import Keys, robot_of

HEADS = {"producer": "service", "stamp_ns": 12, "valid_for_ns": 34, "robot": "left"}
LAW = {"S_h": 0.01, "S_r": 0.02, "S_s": 0.04, "C": 0.08, "Z_d": 0.16, "Z_r": 0.32}


def three(first: float) -> np.ndarray:
    return np.array([first, first + 0.1, first + 0.2])


NEAREST = Nearest(
    source="obstacles",
    link="forearm_link",
    obstacle="ball",
    distance=0.25,
    point_on_link=three(1.0),
    point_on_obstacle=three(2.0),
    normal=three(3.0),
)
COMPARISON = Comparison(
    link="wrist_1_link", estimator="nearest", estimate=0.5, exact=0.4, difference=0.1, disagrees=True
)


def reaction(first: float) -> ReactionTime:
    return ReactionTime(
        sensor_period=first, input_age=first + 1, tick=first + 2, transport=first + 3, robot=first + 4
    )


def separated(limiting: int | None = 1) -> Separated:
    """Two pairs, of an obstacle and of the rings; the laws of the second are worked out by hand below."""
    table = PairTable(
        ids=("ball", "arm"),
        link=np.array([2, 0]),
        obstacle=np.array([1, -1]),
        distance=np.array([0.7, 0.6]),
        exact=np.array([True, False]),
        point_on_link=np.array([three(4.0), three(5.0)]),
        point_on_obstacle=np.array([three(6.0), three(7.0)]),
        normal=np.array([three(8.0), three(9.0)]),
        human_speed=np.array([1.0, 1.6]),
        uncertainty=np.array([0.03, 0.05]),
        reaction_time=np.array([0.1, 0.2]),
        closing=None,  # type: ignore[arg-type]
    )
    levels = StoppingLevels(
        shares=np.array([0.5, 1.0]), times=np.array([0.25, 0.5]), gains=np.array([0.125, 0.375])
    )
    return Separated(
        table=table,
        links=("a", "b", "c"),
        closing_speed=np.array([-0.5, 0.8]),
        max_closing_speed=np.array([0.9, 1.1]),
        shares=np.array([0.4, 0.3]),
        scaling=0.3,
        limiting=limiting,
        limit=SimpleNamespace(levels=levels),  # type: ignore[arg-type]
        level=1,
        reactions={"ranges": reaction(0.5), "obstacles": reaction(0.25)},
        intrusion=0.07,
        robot_uncertainty=0.09,
        red_scaling=0.1,
    )


def decision(**changes: object) -> Decision:
    status = {
        "ranges": SourceStatus(name="ranges", state=SourceState.FRESH, age_s=0.004),
        "obstacles": SourceStatus(name="obstacles", state=SourceState.STALE, age_s=None),
    }
    values = {
        "tick": 77,
        "zone": Zone.YELLOW,
        "momentary_zone": Zone.GREEN,
        "distance": 0.2,
        "nearest": NEAREST,
        "sources": {
            "ranges": SourceReport(status=status["ranges"], required=True, distance=0.6),
            "obstacles": SourceReport(status=status["obstacles"], required=False, distance=None),
        },
        "comparison": COMPARISON,
        "speed_limit": np.array([0.5, 0.75]),
        "speed_scaling": 0.375,
        "velocity": np.array([-0.125, 0.0625]),
        "reasons": ("distance", "stale:obstacles"),
        "position": None,
        "separation": separated(),
    }
    return Decision(**{**values, **changes})  # type: ignore[arg-type]


def zone_of(**changes: object) -> m.Zone:
    return zone_message(decision(**changes), profile="iso", name=["a", "b"], **HEADS)


def test_a_zone_field_by_field():
    zone = zone_of()
    assert (zone.producer, zone.seq, zone.stamp_ns, zone.valid_for_ns) == ("service", 77, 12, 34)
    assert (zone.robot, zone.profile, zone.zone, zone.distance) == ("left", "iso", "yellow", 0.2)
    assert (zone.name, zone.speed_limit, zone.speed_scaling) == (["a", "b"], [0.5, 0.75], 0.375)
    assert zone.reasons == ["distance", "stale:obstacles"]
    assert zone.nearest == m.NearestEntry(
        source="obstacles",
        link="forearm_link",
        obstacle="ball",
        distance=0.25,
        point_on_link=tuple(three(1.0)),
        point_on_obstacle=tuple(three(2.0)),
        normal=tuple(three(3.0)),
    )
    assert zone.sources == {
        "ranges": m.SourceEntry(state="fresh", required=True, age_s=0.004, distance=0.6),
        "obstacles": m.SourceEntry(state="stale", required=False, age_s=None, distance=None),
    }
    assert zone.comparison == m.ComparisonEntry(
        link="wrist_1_link", estimator="nearest", estimate=0.5, exact=0.4, difference=0.1
    )


def test_a_zone_of_nothing_says_so():
    zone = zone_of(nearest=None, comparison=None, separation=None, distance=None)
    assert (zone.nearest, zone.comparison, zone.reaction, zone.limiting) == (None, None, None, None)
    zone = zone_of(separation=separated(limiting=None))
    assert zone.limiting is None
    assert zone.reaction is not None
    assert zone.reaction["sensor_period"] == 0.5  # the longest of the two


def terms(pair: int) -> dict[str, float]:
    """[TS15066] 5.5.4.2.3 with T_s = 0.5 s and 0.375 m of stopping for each m/s; S_h at v_h, S_r at v_r."""
    human, speed, reaction_s, uncertainty = ((1.0, -0.5, 0.1, 0.03), (1.6, 0.8, 0.2, 0.05))[pair]
    single = {
        "S_h": human * (reaction_s + 0.5),
        "S_r": speed * reaction_s,
        "S_s": speed * 0.375,
        "C": 0.07,
        "Z_d": uncertainty,
        "Z_r": 0.09,
    }
    return {"S_p": sum(single.values()), **single}


def test_what_limits_and_its_reaction_time():
    zone = zone_of()
    assert zone.reaction == pytest.approx(
        {"sensor_period": 0.5, "input_age": 1.5, "tick": 2.5, "transport": 3.5, "robot": 4.5, "total": 12.5}
    )
    assert zone.limiting is not None
    assert zone.limiting.separation == pytest.approx(terms(1))
    found = zone.limiting
    assert (found.source, found.link, found.obstacle, found.distance) == ("ranges", "a", None, 0.6)
    assert (found.closing_speed, found.max_closing_speed) == (0.8, 1.1)
    other = zone_of(separation=separated(limiting=0)).limiting
    assert other is not None
    assert (other.source, other.link, other.obstacle) == ("obstacles", "c", "arm")


def test_every_pair_of_a_separation():
    both = separation_pairs(separated(), range(2))
    message = separation_message(
        decision(), both, producer="service", stamp_ns=12, robot="left", profile="iso"
    )
    assert (message.producer, message.seq, message.stamp_ns) == ("service", 77, 12)
    assert (message.robot, message.profile, message.pairs) == ("left", "iso", both)
    assert set(message.reaction) == {"ranges", "obstacles"}
    assert message.reaction["obstacles"]["total"] == 11.25
    pair = both[1]
    assert pair.separation == pytest.approx(terms(1))
    assert (pair.source, pair.link, pair.obstacle) == ("ranges", "a", None)
    assert (pair.distance, pair.exact) == (0.6, False)
    assert (pair.point_on_link, pair.point_on_obstacle) == (tuple(three(5.0)), tuple(three(7.0)))
    assert pair.normal == tuple(three(9.0))
    assert (pair.human_speed, pair.reaction_time, pair.stopping_time) == (1.6, 0.2, 0.5)
    assert (pair.closing_speed, pair.max_closing_speed) == (0.8, 1.1)
    assert (both[0].source, both[0].link, both[0].obstacle, both[0].exact) == ("obstacles", "c", "arm", True)
    assert separation_pairs(separated(), range(1, 2)) == [pair]


def test_a_distance_that_could_not_be_measured_is_contact():
    found = separated()
    found.table.distance[:] = [-np.inf, 0.6]
    assert [pair.distance for pair in separation_pairs(found, range(2))] == [0.0, 0.6]
    zone = zone_of(separation=separated(limiting=0))
    assert zone.limiting is not None
    assert zone.limiting.distance == 0.7


def test_a_command_field_by_field():
    assert command_message(decision(), name=["a", "b"], **HEADS) == m.VelocityCommand(
        producer="service",
        seq=77,
        stamp_ns=12,
        valid_for_ns=34,
        robot="left",
        zone="yellow",
        name=["a", "b"],
        velocity=[-0.125, 0.0625],
    )


def estimate(first: float, **changes: object) -> Estimate:
    values = {"distance": first, "position": (first, 1.0, 2.0), "bearing": -first, "sensors": (3, 1)}
    return Estimate(**{**values, **changes})  # type: ignore[arg-type]


def test_an_evaluation_field_by_field():
    pair = ClosestPair(
        link="forearm_link",
        obstacle="ball",
        distance=0.25,
        point_on_link=three(1.0),
        point_on_obstacle=three(2.0),
        normal=three(3.0),
    )
    estimates = RingEstimates(
        as_printed=estimate(0.1, position=None, bearing=None),
        corrected=None,
        nearest=estimate(0.3),
        sphere_fit=estimate(0.4, std=0.004),
        lower_bound=estimate(0.5),
        reasons={"corrected": "no_triangle"},
    )
    kinematics = Robot.load("ur3").kinematics(np.array([0.1, -1.0, 1.2, 0.3, 0.4, 0.5]))
    values = {
        "zone": Zone.RED,
        "distance": 0.25,
        "speed_limit": np.array([0.5, 0.75]),
        "speed_scaling": 0.375,
        "reasons": ("distance",),
        "pairs": (
            EvaluatedPair(
                pair=pair, closing_speed=0.6, max_closing_speed=0.9, separation=SeparationTerms(**LAW)
            ),
            EvaluatedPair(pair=pair, closing_speed=None),
        ),
        "estimates": estimates,
        "kinematics": kinematics,
        "velocity": np.array([0.125, -0.5]),
    }
    message = evaluate_message(Evaluation(**values))  # type: ignore[arg-type]
    assert (message.zone, message.distance, message.speed_limit) == ("red", 0.25, [0.5, 0.75])
    assert (message.speed_scaling, message.reasons) == (0.375, ["distance"])
    same = {
        "link": "forearm_link",
        "obstacle": "ball",
        "distance": 0.25,
        "point_on_link": tuple(three(1.0)),
        "point_on_obstacle": tuple(three(2.0)),
        "normal": tuple(three(3.0)),
    }
    law = {"S_p": SeparationTerms(**LAW).S_p, **LAW}
    assert message.pairs == [
        m.PairEntry(**same, closing_speed=0.6, max_closing_speed=0.9, separation=law),
        m.PairEntry(**same, closing_speed=None, max_closing_speed=None, separation=None),
    ]
    assert message.estimates == m.EstimatesEntry(
        as_printed=m.EstimateEntry(distance=0.1, position=None, bearing=None, sensors=[3, 1]),
        corrected=None,
        nearest=m.EstimateEntry(distance=0.3, position=(0.3, 1.0, 2.0), bearing=-0.3, sensors=[3, 1]),
        sphere_fit=m.EstimateEntry(
            distance=0.4, position=(0.4, 1.0, 2.0), bearing=-0.4, sensors=[3, 1], std=0.004
        ),
        lower_bound=m.EstimateEntry(distance=0.5, position=(0.5, 1.0, 2.0), bearing=-0.5, sensors=[3, 1]),
        reasons={"corrected": "no_triangle"},
    )
    assert message.command == m.CommandEntry(velocity=[0.125, -0.5])
    assert np.array_equal(message.frames.sensors, kinematics.transform_sensors_to_base)
    assert np.array_equal(message.frames.end_effector, kinematics.transform_end_effector_to_base)
    assert np.array_equal(message.jacobian, kinematics.jacobian)
    bare = evaluate_message(Evaluation(**{**values, "estimates": None, "velocity": None, "pairs": ()}))  # type: ignore[arg-type]
    assert (bare.estimates, bare.command, bare.pairs) == (None, None, [])


def test_frames_are_those_of_the_robot(robot: Robot):
    position = np.array([0.1, -1.0, 1.2, 0.3, 0.4, 0.5])
    message = frames_message(robot, "left", position)
    kinematics: Kinematics = robot.kinematics(position)
    assert (message.robot, message.name, message.position) == (
        "left",
        list(robot.joint_names),
        position.tolist(),
    )
    assert np.array_equal(message.sensors, kinematics.transform_sensors_to_base)
    assert np.array_equal(message.end_effector, kinematics.transform_end_effector_to_base)
    assert np.array_equal(message.jacobian, kinematics.jacobian)
    assert message.links == {link: T.tolist() for link, T in robot.link_transforms(position).items()}


def test_a_question_is_read_by_the_names_it_gives(robot: Robot):
    position = [0.1, -1.0, 1.2, 0.3, 0.4, 0.5]
    names = list(reversed(robot.joint_names))
    ball = m.ObstacleEntry(id="ball", shape="sphere", size=[0.1], position=(1.0, 0.0, 0.0))
    target = m.EvaluateTarget(kind="position", value=[0.3, 0.1, 0.4], controller="field")
    asked = m.EvaluateInput(
        position=position[::-1],
        velocity=[0.06, 0.05, 0.04, 0.03, 0.02, 0.01],
        name=names,
        ranges=[0.5, *[None] * 7],
        obstacles=[ball],
        target=target,
    )
    question = question_from(robot, asked)
    assert question.joints.position.tolist() == position
    assert question.joints.velocity.tolist() == [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]
    assert question.velocity_known
    assert question.ranges is not None
    assert question.ranges.tolist() == [0.5, *[np.inf] * 7]
    assert question.obstacles is not None
    assert [obstacle.id for obstacle in question.obstacles] == ["ball"]
    assert question.target is not None
    assert (question.target.kind, question.target.controller) == ("position", "field")
    assert question.target.value.tolist() == [0.3, 0.1, 0.4]


def test_a_question_of_a_position_alone_knows_nothing_else(robot: Robot):
    question = question_from(robot, m.EvaluateInput(position=[0.0, -1.0, 1.0, 0.0, 0.0, 0.0]))
    assert question.joints.velocity.tolist() == [0.0] * 6
    assert not question.velocity_known
    assert (question.ranges, question.obstacles, question.target) == (None, None, None)


def test_vectors_and_readings_are_plain_numbers():
    assert vector(three(1.0)) == (1.0, 1.1, 1.2)
    assert optional_readings(np.array([0.5, np.inf, 0.0])) == [0.5, None, 0.0]


def test_keys_and_encodings():
    keys = Keys("left")
    assert (keys.input("joints"), keys.output("zone"), keys.alive) == (
        "ssm/left/in/joints",
        "ssm/left/zone",
        "ssm/left/alive",
    )
    assert robot_of("ssm/left/zone") == robot_of("ssm/left") == "left"
    assert encoding_of(m.Zone) == "application/json;ssm.Zone/1"


def test_all_messages_are_described_in_one_document():
    document = json_schemas()
    assert list(document) == ["$schema", "title", "$defs"]
    assert document["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert document["title"] == f"ssm_service messages, version {m.VERSION}"
    assert {message.__name__ for message in m.ALL} <= set(document["$defs"])
    assert '"$ref": "#/$defs/ObstacleEntry"' in json.dumps(document["$defs"]["Obstacles"])


@pytest.mark.parametrize(
    ("encoding", "another"),
    [
        ("application/json;ssm.Zone/1;q=1", True),
        ("application/json;charset=utf-8;ssm.Zone/1", False),
        ("application/json;ssm.Ranges/1", False),
        ("application/json", False),
        ("", False),
    ],
)
def test_the_schema_is_what_follows_the_first_semicolon(encoding, another):
    assert names_another(encoding, m.Ranges) == another
