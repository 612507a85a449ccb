"""Every estimator has its own place in a message."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ssm_service.monitor import Evaluation
from ssm_service.perception import Estimate, RingEstimates
from ssm_service.safety import Zone
from ssm_service.wire import evaluate_message
from ssm_service.wire import messages as m

NAMES = ("as_printed", "corrected", "nearest", "sphere_fit", "lower_bound")


@pytest.mark.parametrize("alone", NAMES)
def test_an_estimate_alone_is_in_its_own_place(alone: str) -> None:
    estimates: dict[str, Any] = dict.fromkeys(NAMES)
    estimates[alone] = Estimate(distance=0.5, position=None, bearing=0.25, sensors=(2,))
    kinematics: Any = SimpleNamespace(
        transform_sensors_to_base=np.eye(4)[np.newaxis],
        transform_end_effector_to_base=np.eye(4),
        jacobian=np.zeros((3, 2)),
    )
    message = evaluate_message(
        Evaluation(
            zone=Zone.GREEN,
            distance=None,
            speed_limit=np.ones(2),
            speed_scaling=1.0,
            reasons=(),
            pairs=(),
            estimates=RingEstimates(**estimates, reasons={}),
            kinematics=kinematics,
            velocity=None,
        )
    )
    expected = m.EstimateEntry(distance=0.5, position=None, bearing=0.25, sensors=[2])
    assert message.estimates is not None
    for name in NAMES:
        assert getattr(message.estimates, name) == (expected if name == alone else None)
