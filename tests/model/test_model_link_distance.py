"""The distance table against Coal, on meshes and on primitive shapes; never above, and how far below."""

import coal
import numpy as np
import pytest
from model_oracle import write_robot

from ssm_service.errors import InputError
from ssm_service.model import LinkDistance, Robot


@pytest.fixture(scope="module")
def robot():
    return Robot.load("ur3")


@pytest.fixture(scope="module")
def forearm(robot):
    return LinkDistance(robot, "forearm_link")


def coal_distances(robot, link, points):
    probe, request, result = coal.Sphere(1e-9), coal.DistanceRequest(), coal.DistanceResult()
    sources = [robot.collision.geometryObjects[i] for i in robot.geometry_of_link[link]]
    found = np.empty(len(points))
    for i, point in enumerate(points):
        least = np.inf
        for source in sources:
            placement = coal.Transform3s(source.placement.rotation, source.placement.translation)
            here = coal.Transform3s(np.eye(3), point)
            result.clear()
            least = min(least, coal.distance(source.geometry, placement, probe, here, request, result) + 1e-9)
        found[i] = least
    return found


def points_round(surface, margin, count, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(surface.box[:3] - margin, surface.box[3:] + margin, (count, 3))


@pytest.mark.parametrize(
    ("margin", "p99_mm"), [(0.08, 1.0), (0.2, 1.0), (0.55, 1.5), (1.6, 2.5), (4.0, 30.0)]
)
def test_never_above_coal_and_little_below(robot, forearm, margin, p99_mm):
    points = points_round(forearm, margin, 600, 1)
    truth, low = coal_distances(robot, "forearm_link", points), forearm.lower(points)
    assert (low <= truth + 1e-7).all()
    outside = (low > 0.0) & (truth > 0.01)
    assert (truth - low <= forearm.tolerance(low) + 1e-9)[outside].all()
    assert np.percentile((truth - low)[outside], 99) < 1e-3 * p99_mm
    assert np.median((truth - low)[outside]) < 2e-4 if margin < 4.0 else True
    np.testing.assert_array_equal(low, forearm.distance(points))


def test_beyond_the_table_the_box_is_a_bound(robot, forearm):
    points = points_round(forearm, 30.0, 300, 2)
    truth, low = coal_distances(robot, "forearm_link", points), forearm.lower(points)
    assert (low <= truth + 1e-7).all()
    assert (truth - low < 0.7).all()


def test_deep_inside_is_zero(forearm):
    axis = np.column_stack([np.zeros(20), np.zeros(20), np.linspace(0.03, 0.2, 20)])
    np.testing.assert_array_equal(forearm.lower(axis), 0.0)


def test_upper_bound_of_the_kernel(robot, forearm):
    from ssm_service.model.link_table import upper

    points = points_round(forearm, 0.5, 800, 3)
    truth, low = coal_distances(robot, "forearm_link", points), forearm.lower(points)
    above = np.array([upper(*forearm.table, forearm.near_points, *point) for point in points])
    outside = low > 0.0
    assert (above >= truth - 1e-9)[outside].all()
    near = outside & (truth < 0.2) & (truth > 0.02)
    assert np.median((above - truth)[near]) < 1e-3


PRIMITIVES = """
<robot name="p"><link name="base"/>
<link name="arm">
<collision><origin xyz="0.1 0 0.2" rpy="0.3 0.2 0.1"/>
<geometry><box size="0.1 0.2 0.3"/></geometry></collision>
<collision><origin xyz="-0.2 0.1 0"/><geometry><sphere radius="0.07"/></geometry></collision>
<collision><origin xyz="0 0 -0.2" rpy="1 0 0"/>
<geometry><cylinder radius="0.05" length="0.3"/></geometry></collision>
</link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>
"""


def test_primitive_shapes(tmp_path):
    (tmp_path / "p.urdf").write_text(PRIMITIVES)
    robot = Robot.load(write_robot(tmp_path, urdf="p.urdf", frame="arm"))
    surface = LinkDistance(robot, "arm")
    points = points_round(surface, 0.3, 1500, 4)
    truth, low = np.maximum(coal_distances(robot, "arm", points), 0.0), surface.lower(points)
    assert (low <= truth + 1e-6).all()
    assert np.percentile(truth - low, 99) < 3e-3
    assert np.median(truth - low) < 2e-4


def test_refuses_what_it_cannot_measure(robot, forearm):
    with pytest.raises(InputError, match="forearm_link"):
        LinkDistance(robot, "elbow")
    with pytest.raises(InputError):
        forearm.lower(np.zeros(3))
    with pytest.raises(InputError):
        forearm.distance(np.array([[0.0, np.nan, 0.0]]))
    assert not any(array.flags.writeable for array in (*forearm.table, forearm.near_points))
