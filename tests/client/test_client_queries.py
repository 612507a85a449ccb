import os
import subprocess
import sys
import time

import numpy as np
import pytest

from ssm_service import Client
from ssm_service.client.chunks import CHUNK_OBSTACLES, chunks
from ssm_service.errors import (
    ConfigError,
    DuplicateServiceError,
    InputError,
    NoServiceError,
    ServiceError,
)


@pytest.fixture
def client(endpoint):
    with Client("arm", connect=(endpoint,), timeout_s=2.0) as client:
        yield client


def test_nobody_there_is_an_error_in_time(endpoint):
    with Client("arm", connect=(endpoint,), timeout_s=0.3) as client:
        for question in (
            client.zone,
            client.command,
            client.health,
            client.robots,
            lambda: client.evaluate([{}]),
        ):
            begin = time.monotonic()
            with pytest.raises(NoServiceError, match=endpoint):
                question()
            assert time.monotonic() - begin < 3.0


def test_another_robot_than_the_one_there_is_nobody(endpoint, pretended):
    pretended()
    with (
        Client("other", connect=(endpoint,), timeout_s=0.5) as client,
        pytest.raises(NoServiceError, match="zone"),
    ):
        client.zone()


def test_answers_come_as_messages(client, pretended):
    pretended()
    assert client.zone().zone == "green"
    assert client.command().velocity == [0.5, 0.5, 0.5]
    assert client.config() == {"rate_hz": 400}
    assert client.robots() == ["arm"]


def test_an_answer_of_error_and_a_malformed_one_are_errors_with_their_text(client, pretended):
    pretended()
    with pytest.raises(ServiceError, match="no fresh joint state"):
        client.frames()
    with pytest.raises(ServiceError, match="malformed"):
        client.health()


def test_two_services_are_an_error(client, pretended):
    pretended(producer="first")
    pretended(listen=False, producer="second")
    for question in (
        client.zone,
        client.command,
        client.config,
        lambda: client.evaluate([{"position": [0]}]),
    ):
        with pytest.raises(DuplicateServiceError):
            question()


def test_evaluate_keeps_the_order_over_many_queries(client, pretended):
    pretended()
    answers = client.evaluate([{"position": [index]} for index in range(75)])
    assert [answer.error.split(":")[1] for answer in answers] == [str(index) for index in range(75)]
    assert {answer.error.split(":")[0] for answer in answers} == {"32", "11"}
    assert client.evaluate([]) == []


def test_chunks_bound_the_obstacles_too():
    obstacle = {"id": "a", "shape": "sphere", "size": [0.1], "position": [1.0, 0.0, 0.0]}
    inputs = [{"position": [0.0], "obstacles": [obstacle] * count} for count in (200, 100, 1000, 1)]
    assert [chunk.count for chunk in chunks(inputs)] == [1, 1, 1, 1]
    inputs = [{"position": [0.0], "obstacles": [obstacle] * (CHUNK_OBSTACLES // 4)}] * 8
    assert [chunk.count for chunk in chunks(inputs)] == [4, 4]


@pytest.mark.parametrize("reading", [float("nan"), float("inf"), np.float64("nan")])
def test_a_reading_that_json_would_turn_into_no_echo_is_refused(reading):
    with pytest.raises(InputError) as caught:
        list(chunks([{"position": [0.0]}, {"position": [0.0], "ranges": [reading]}]))
    assert caught.value.cause == "not_finite"
    assert caught.value.where == "inputs[1]"


def test_arrays_may_be_given():
    (chunk,) = chunks([{"position": np.zeros(2)}])
    assert chunk.payload == b'[{"position":[0.0,0.0]}]'


def test_bad_settings_are_the_callers_to_hear_of():
    with pytest.raises(ConfigError):
        Client("a/b")
    with pytest.raises(ConfigError):
        Client("arm", connect=("nonsense",))
    with pytest.raises(ConfigError):
        Client("arm", zenoh_config="/nowhere.json5")


def test_a_program_that_forgets_to_close_still_ends(pretended, endpoint):
    pretended()
    program = (
        "import sys; from ssm_service import Client; c = Client('arm', connect=(sys.argv[1],), timeout_s=5); "
        "c.zone(); s = c.stream(); next(s); sys.exit(3)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program, endpoint], timeout=30, env=dict(os.environ), check=False
    )
    assert ended.returncode == 3


def test_a_closed_client_says_so(client, pretended):
    pretended()
    client.zone()
    client.close()
    with pytest.raises(NoServiceError, match="closed"):
        client.zone()
    assert next(client.stream()).reasons == ("waiting:service",)


def test_a_reset_says_what_was_cleared(client, pretended):
    pretended()
    reply = client.reset()
    assert (reply.robot, reply.cleared) == ("arm", "corruption on in/joints")


def refusal(question):
    try:
        question()
    except ServiceError as error:
        return str(error)
    return None


def test_an_answer_without_a_checksum_is_none(client, pretended):
    service = pretended()
    client.zone()
    service.wish(fault="no_crc")
    # The wish takes its time; everything after the first refusal is refused as well.
    deadline = time.monotonic() + 5.0
    while refusal(client.config) is None and time.monotonic() < deadline:
        time.sleep(0.01)
    for question in (client.config, client.zone, client.command, client.reset):
        assert "malformed: attachment: found None" in refusal(question)
    assert "malformed" in refusal(lambda: client.evaluate([{"position": [0]}]))
