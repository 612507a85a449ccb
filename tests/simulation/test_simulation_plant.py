"""The plant against the lag's differential equation, its closed form and the joints' limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ssm_service.errors import InputError
from ssm_service.model import Robot
from ssm_service.simulation import Plant


def test_closed_form_from_rest(ur3: Robot) -> None:
    tau, dt = 0.03, 0.002
    command = 0.5 * ur3.velocity_limit
    plant = Plant(ur3, time_constant_s=tau)
    start = plant.position.copy()
    for step in range(1, 101):
        plant.step(command, dt)
        t = step * dt
        np.testing.assert_allclose(plant.velocity, command * (1 - math.exp(-t / tau)), rtol=1e-12)
        moved = command * (t - tau * (1 - math.exp(-t / tau)))
        np.testing.assert_allclose(plant.position - start, moved, rtol=1e-11, atol=1e-15)


def test_solves_its_differential_equation(ur3: Robot) -> None:
    tau, dt = 0.02, 0.01
    generator = np.random.default_rng(4)
    commands = generator.uniform(-1.0, 1.0, (30, 6))
    plant = Plant(ur3, np.full(6, 0.1), time_constant_s=tau)
    state = np.concatenate((plant.position, plant.velocity))
    for command in commands:
        plant.step(command, dt)
        solution = solve_ivp(
            lambda _t, y, u=command: np.concatenate((y[6:], (u - y[6:]) / tau)),
            (0.0, dt),
            state,
            rtol=1e-10,
            atol=1e-12,
        )
        state = solution.y[:, -1]
        np.testing.assert_allclose(np.concatenate((plant.position, plant.velocity)), state, atol=1e-8)


def test_step_length_makes_no_difference(ur3: Robot) -> None:
    coarse, fine = Plant(ur3), Plant(ur3)
    generator = np.random.default_rng(5)
    for _ in range(20):
        command = generator.uniform(-1.0, 1.0, 6)
        coarse.step(command, 0.05)
        for part in generator.dirichlet(np.ones(7)):
            fine.step(command, 0.05 * part)
    np.testing.assert_allclose(coarse.position, fine.position, atol=1e-13)
    np.testing.assert_allclose(coarse.velocity, fine.velocity, atol=1e-13)


def test_no_lag_follows_at_once(ur3: Robot) -> None:
    plant, command = Plant(ur3, time_constant_s=0.0), np.array([0.1, -0.2, 0.3, 0.0, 0.5, -0.6])
    start = plant.position.copy()
    plant.step(command, 0.25)
    np.testing.assert_array_equal(plant.velocity, command)
    np.testing.assert_allclose(plant.position - start, command * 0.25, rtol=1e-14)


def test_stays_within_limits_and_says_so(ur3: Robot) -> None:
    plant = Plant(ur3, ur3.position_upper - 0.05)
    for _ in range(200):
        plant.step(np.full(6, 1.0), 0.002)
        assert (plant.position <= ur3.position_upper).all()
    assert plant.at_limit == ur3.joint_names
    assert plant.limit_hits == 6
    np.testing.assert_array_equal(plant.position, ur3.position_upper)
    np.testing.assert_array_equal(plant.velocity, np.zeros(6))
    plant.step(np.full(6, -1.0), 0.002)
    assert plant.at_limit == ()
    assert (plant.velocity < 0.0).all()


def test_never_faster_than_its_joints(ur3: Robot) -> None:
    plant = Plant(ur3)
    generator = np.random.default_rng(6)
    for _ in range(300):
        plant.step(generator.uniform(-50.0, 50.0, 6), 0.01)
        assert (np.abs(plant.velocity) <= ur3.velocity_limit).all()
        assert (ur3.position_lower <= plant.position).all()
        assert (plant.position <= ur3.position_upper).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_refuses_what_is_no_number_and_does_not_move(ur3: Robot, bad: float) -> None:
    plant = Plant(ur3)
    before = plant.position.copy()
    with pytest.raises(InputError) as caught:
        plant.step(np.array([0.1, 0.1, bad, 0.0, 0.0, 0.0]), 0.002)
    assert caught.value.cause == "not_finite"
    np.testing.assert_array_equal(plant.position, before)
    with pytest.raises(InputError):
        plant.step(np.zeros(6), bad)
    with pytest.raises(InputError):
        plant.step(np.zeros(5), 0.002)


def test_refuses_a_start_beyond_the_limits(ur3: Robot) -> None:
    with pytest.raises(InputError) as caught:
        Plant(ur3, ur3.position_upper + 0.1)
    assert caught.value.cause == "out_of_range"
