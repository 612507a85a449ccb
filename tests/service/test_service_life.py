"""Beginning, ending, freezing and dying, with signals to real processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from typing import Any

import pytest
import zenoh
from service_kit import (
    POSITION,
    RECOVERY_TICKS,
    Ear,
    ServiceUnderTest,
    alive,
    driving,
    free_port,
    listening,
    running,
    wait_for,
    without_gaps,
)


@pytest.fixture(params=["service", "command"])
def ending(request):
    """A service with a driver, once through the function and once through the command line."""
    command = [sys.executable, "-m", "ssm_service.cli", "run", "--robot", "ur3", "--listen", "ENDPOINT"]
    with (
        running(command=command if request.param == "command" else None) as service,
        driving(service.endpoint),
        listening(service.endpoint) as ear,
    ):
        ear.until(lambda zone: zone["reasons"] == ["distance"])
        yield service, ear


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_within_a_second_with_a_last_stop(ending, number):
    service, ear = ending
    children = service.children()
    assert len(children) == 1
    began = time.monotonic()
    service.signal(number)
    assert service.popen.wait(10) == 0
    took = time.monotonic() - began
    assert took < 1.0
    last = wait_for(lambda: [zone for zone in ear.zones(began) if zone["reasons"] == ["shutdown"]])[0]
    assert last == ear.zones()[-1]
    assert last["zone"] == "stop"
    assert set(last["speed_limit"]) == {0.0}
    command = ear.heard("command")[-1].value
    assert (command["seq"], set(command["velocity"])) == (last["seq"], {0.0})
    assert without_gaps(ear.zones(began))
    assert not any(map(alive, children))
    assert "Traceback" not in service.output()


def test_the_token_goes_with_the_service():
    port = free_port()
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as router, running(connect=[f"tcp/127.0.0.1:{port}"]) as service:
        tokens: list[str] = []
        with router.liveliness().declare_subscriber(
            "ssm/**", lambda s: tokens.append(str(s.kind)), history=True
        ):
            wait_for(lambda: tokens)
            service.signal(signal.SIGTERM)
            wait_for(lambda: len(tokens) == 2, 2.0)
            service.popen.wait(10)
        assert list(router.liveliness().get("ssm/**")) == []


def test_a_dead_evaluating_process_is_started_again_and_the_zone_goes_on():
    question = json.dumps([{"position": POSITION}])
    with (
        running() as service,
        driving(service.endpoint),
        listening(service.endpoint) as ear,
    ):
        ear.until(lambda zone: zone["reasons"] == ["distance"])
        assert ear.ask("evaluate", question)[0] == "ok"
        (first,) = service.children()
        ear.forget()
        os.kill(first, signal.SIGKILL)
        # It is noticed within a second, and needs some to start; the zone does not wait for it.
        wait_for(lambda: [pid for pid in service.children() if pid != first], 5.0)

        def answers() -> bool:
            replies = list(ear.session.get("ssm/ur3/evaluate", payload=question, timeout=1.0))
            return any(reply.ok is not None for reply in replies)

        wait_for(answers, 20.0)
        assert {zone["zone"] for zone in ear.zones()} <= {"yellow", "red", "stop"}
        assert "yellow" in {zone["zone"] for zone in ear.zones()}
        assert any("evaluating process died" in text for text in ear.health()["warnings"])
        (second,) = service.children()
        service.signal(signal.SIGKILL)
        service.popen.wait(10)
        wait_for(lambda: not alive(second), 3.0, "no evaluating process left behind")


def freeze_and_thaw(service: ServiceUnderTest, ear: Ear, seconds: float) -> list[dict[str, Any]]:
    """Return the zones that are decided afterwards, up to the first that is not a stop."""
    service.signal(signal.SIGSTOP)
    time.sleep(seconds)
    ear.forget()
    thawed_ns = time.time_ns()
    service.signal(signal.SIGCONT)
    ear.until(lambda zone: zone["zone"] == "yellow" and zone["stamp_ns"] > thawed_ns, 10.0)
    zones = ear.zones()
    # One that was on its way into Zenoh at that very moment cannot be called back; the next tick stops.
    assert sum(zone["stamp_ns"] < thawed_ns for zone in zones) <= 1
    return [zone for zone in zones if zone["stamp_ns"] >= thawed_ns]


def test_a_frozen_service_never_sends_an_old_decision_as_new():
    with (
        running() as service,
        driving(service.endpoint),
        listening(service.endpoint) as ear,
    ):
        for freeze in (0.06,) * 8 + (1.0,):
            ear.until(lambda zone: zone["reasons"] == ["distance"], 10.0)
            zones = freeze_and_thaw(service, ear, freeze)
            left = next(zone for zone in zones if zone["zone"] != "stop")
            if freeze < 0.1:  # within the lease the link holds, and the first decision is heard
                assert zones[0]["zone"] == "stop"
                assert "overrun" in zones[0]["reasons"] or "overrun" in zones[1]["reasons"]
                assert left["seq"] - zones[0]["seq"] >= RECOVERY_TICKS
        health = ear.health()
        assert health["overruns"] >= 9
        assert health["skipped"] >= (8 * 0.06 + 1.0) * 500 * 0.9
        # The evaluating process has found its way back, too.
        assert wait_for(
            lambda: [
                reply.ok is not None
                for reply in ear.session.get(
                    "ssm/ur3/evaluate", payload=json.dumps([{"position": POSITION}]), timeout=1.0
                )
            ],
            10.0,
        ) == [True]


def robots(ear: Ear) -> list[str]:
    return sorted(str(reply.ok.key_expr) for reply in ear.session.liveliness().get("ssm/*/alive"))


def test_a_second_service_of_the_same_name_refuses_to_start():
    with running() as first, listening(first.endpoint) as ear:
        second = ServiceUnderTest(connect=[first.endpoint])
        try:
            assert second.popen.wait(30) == 1
            assert "DuplicateServiceError" in second.output()
            assert "--name" in second.output()
        finally:
            second.kill()
        assert "duplicate:service" not in ear.next_zone()["reasons"]
        with running(connect=[first.endpoint], name="other") as other, listening(other.endpoint) as one:
            wait_for(lambda: robots(one) == ["ssm/other/alive", "ssm/ur3/alive"], 5.0)


def test_two_services_that_meet_later_both_stop_until_one_ends():
    router_port = free_port()
    router_endpoint = f"tcp/127.0.0.1:{router_port}"
    options = {"connect": [router_endpoint]}
    with (
        running(ready=False, **options) as one,
        running(ready=False, **options) as two,
    ):
        one.wait_until_ready()
        two.wait_until_ready()
        with (
            driving(one.endpoint),
            driving(two.endpoint),
            listening(one.endpoint) as ear_one,
            listening(two.endpoint) as ear_two,
        ):
            for ear in (ear_one, ear_two):
                ear.until(lambda zone: zone["reasons"] == ["distance"])
            config = zenoh.Config()
            config.insert_json5("mode", '"router"')
            config.insert_json5("listen/endpoints", json.dumps([router_endpoint]))
            config.insert_json5("scouting/multicast/enabled", "false")
            with zenoh.open(config):
                producers = set()
                for ear in (ear_one, ear_two):
                    zone = ear.until(lambda zone: "duplicate:service" in zone["reasons"], 15.0)
                    assert zone["zone"] == "stop"
                ear_one.forget()
                time.sleep(0.3)
                for zone in ear_one.zones():
                    producers.add(zone["producer"])
                    assert zone["zone"] == "stop"
                assert len(producers) == 2
                for service in (one, two):
                    wait_for(lambda service=service: "another service" in service.output())
                two.kill()
                ear_one.until(lambda zone: zone["reasons"] == ["distance"], 10.0)


def test_an_unknown_profile_or_rate_or_port_is_said_and_nothing_is_left():
    with running() as first:
        endpoint = first.endpoint
        services = [
            ServiceUnderTest(profile="kang2021"),
            ServiceUnderTest(rate_hz=5000),
            ServiceUnderTest(listen=[endpoint]),
            ServiceUnderTest(name="a/b"),
        ]
        try:
            for service, words in zip(
                services, ("kang2022", "50 to 1000", "could not be opened", "--name"), strict=True
            ):
                assert service.popen.wait(30) == 1
                assert words in service.output()
                assert "Traceback" not in service.output()
        finally:
            for service in services:
                service.kill()


def test_rates_hold():
    with (
        running(ready=False, rate_hz=50) as slow,
        running(ready=False, rate_hz=1000) as fast,
    ):
        for service, rate in ((slow, 50), (fast, 1000)):
            service.wait_until_ready()
            with driving(service.endpoint), listening(service.endpoint) as ear:
                ear.until(lambda zone: zone["reasons"] == ["distance"])
                ear.forget()
                before = ear.health()
                time.sleep(2.5)
                after = ear.health()
                zones = ear.zones()
            assert without_gaps(zones)
            seconds = after["uptime_s"] - before["uptime_s"]
            ticks = after["ticks"] - before["ticks"]
            skipped = after["skipped"] - before["skipped"]
            heard = (zones[-1]["seq"] - zones[0]["seq"]) / (
                1e-9 * (zones[-1]["stamp_ns"] - zones[0]["stamp_ns"])
            )
            print(f"{rate} Hz: {ticks / seconds:.2f} Hz, heard {heard:.2f} Hz, {skipped} skipped")
            # The grid never drifts; a machine that is too slow skips ticks, which are counted.
            assert (ticks + skipped) / seconds == pytest.approx(rate, rel=0.01, abs=1 / seconds)
            assert heard == pytest.approx(rate, rel=0.01 + skipped / max(ticks, 1))
            assert skipped < 0.1 * ticks
            assert after["lateness_us"]["p50"] < 0.25e6 / rate
            assert zones[0]["valid_for_ns"] == (60_000_000 if rate == 50 else 20_000_000)


FROZEN_CLIENT = """
import sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["{sys.argv[1]}"]')
with zenoh.open(config) as session:
    ear = session.declare_subscriber("ssm/ur3/**", zenoh.handlers.RingChannel(1))
    print("listening", flush=True)
    time.sleep(60)
"""


def test_a_frozen_client_does_not_delay_the_end():
    """Zenoh alone would take ten seconds to say goodbye to it."""
    command = [sys.executable, "-m", "ssm_service.cli", "run", "--robot", "ur3", "--listen", "ENDPOINT"]
    with running(command=command) as service:
        client = subprocess.Popen(
            [sys.executable, "-c", FROZEN_CLIENT, service.endpoint], stdout=subprocess.PIPE, text=True
        )
        try:
            assert client.stdout is not None
            assert client.stdout.readline() == "listening\n"
            time.sleep(0.5)
            client.send_signal(signal.SIGSTOP)
            time.sleep(0.05)  # less than the lease: the link still counts as alive
            began = time.monotonic()
            service.signal(signal.SIGINT)
            assert service.popen.wait(20) == 0
            assert time.monotonic() - began < 1.0
        finally:
            client.kill()
            client.communicate()
