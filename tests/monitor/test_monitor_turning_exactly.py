"""A twist that turns about any axis is refused where the free joints cannot hold an orientation."""

from __future__ import annotations

import pytest

from ssm_service.errors import InputError
from ssm_service.model import Robot
from ssm_service.monitor import checked_target


@pytest.mark.parametrize("axis", range(3))
def test_a_twist_about_each_axis(robot: Robot, axis: int) -> None:
    turning = [0.0] * 3
    turning[axis] = 0.5
    with pytest.raises(InputError) as caught:
        checked_target(robot, "twist", [0.1, 0.2, 0.3, *turning])
    assert caught.value.found == turning
