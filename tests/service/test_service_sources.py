"""Waiting, stale, invalid, recovering: what the network makes of the sources' ages."""

from __future__ import annotations

import itertools
import json
import os
import signal
import time
from collections.abc import Iterator

import pytest
from service_kit import (
    BALL,
    FAR,
    HEALTHY,
    JOINT_FIELDS,
    OBSTACLE_FIELDS,
    RANGE_FIELDS,
    RECOVERY_TICKS,
    TARGET_FIELDS,
    Ear,
    ServiceUnderTest,
    driving,
    driving_in_process,
    listening,
    running,
    wait_for,
)

TICK = 0.002
ALLOWANCE = 0.25
"""What a loaded machine and the observer's own process may add to a time [s]."""

WITHOUT_TARGET = {source: HEALTHY[source] for source in ("joints", "ranges", "obstacles")}


@pytest.fixture(scope="module")
def service() -> Iterator[ServiceUnderTest]:
    with running() as service:
        yield service


@pytest.fixture
def observer(service: ServiceUnderTest) -> Iterator[Ear]:
    with listening(service.endpoint) as ear:
        yield ear


def calm(ear: Ear) -> None:
    """Wait until nothing is fresh any more."""
    ear.until(lambda zone: all(source["state"] != "fresh" for source in zone["sources"].values()))


def test_until_everything_required_has_arrived_it_waits_and_says_for_what(observer):
    """First of all in this module: 'waiting' is said only of what never came."""
    zone = observer.next_zone()
    assert (zone["zone"], zone["reasons"]) == ("stop", ["waiting:joints", "waiting:ranges", "waiting:target"])
    assert zone["distance"] is None
    assert set(zone["speed_limit"]) == {0.0}
    assert {source["state"] for source in zone["sources"].values()} == {"absent"}
    with driving_in_process(observer, joints=JOINT_FIELDS) as send:
        zone = send.until(lambda zone: zone["sources"]["joints"]["state"] == "fresh")
        assert (zone["zone"], zone["reasons"]) == ("stop", ["waiting:ranges", "waiting:target"])
    with driving_in_process(observer, joints=JOINT_FIELDS, ranges=RANGE_FIELDS) as send:
        zone = send.until(lambda zone: zone["zone"] == "green")
        assert zone["reasons"] == ["waiting:target"]
        command = observer.heard("command")[-1].value
        assert set(command["velocity"]) == {0.0}
    with driving_in_process(
        observer, joints=JOINT_FIELDS, ranges=RANGE_FIELDS, target=TARGET_FIELDS, obstacles={"obstacles": []}
    ) as send:
        zone = send.until(lambda zone: zone["zone"] == "green" and not zone["reasons"])
        assert zone["distance"] is None


def test_the_zone_rises_at_once_and_falls_after_exactly_the_recovery_ticks(service, observer):
    calm(observer)
    observer.forget()
    with driving(service.endpoint):
        observer.until(lambda zone: zone["zone"] == "yellow")
    zones = {zone["seq"]: zone for zone in observer.zones()}
    left = next(seq for seq, zone in zones.items() if zone["zone"] != "stop")
    before = [zones[seq] for seq in range(left - RECOVERY_TICKS + 1, left) if seq in zones]
    assert before
    assert all("recovering" in zone["reasons"] for zone in before)
    # The last good tick is the one that leaves stop; the one before the first good tick was not good.
    assert "recovering" not in zones[left - RECOVERY_TICKS]["reasons"]


def test_a_killed_driver_is_noticed_within_its_timeout(service, observer):
    calm(observer)
    with driving(service.endpoint) as driver:
        observer.until(lambda zone: zone["zone"] == "yellow")
        observer.forget()
        killed = time.monotonic()
        os.kill(driver.pid, signal.SIGKILL)
        zone = observer.until(lambda zone: "stale:joints" in zone["reasons"])
    heard = next(one for one in observer.heard() if "stale:joints" in one.value["reasons"])
    assert zone["zone"] == "stop"
    assert heard.at - killed <= 0.1 + 2 * TICK + ALLOWANCE
    # By the service's own account: the last fresh tick lies within the timeout, whatever the machine did.
    ages = [zone["sources"]["joints"]["age_s"] for zone in observer.zones() if zone["zone"] != "stop"]
    assert max(ages) <= 0.1
    assert 0.1 < heard.value["sources"]["joints"]["age_s"] <= 0.1 + 2 * TICK + ALLOWANCE
    for source in ("ranges", "obstacles", "target"):
        observer.until(lambda zone, source=source: f"stale:{source}" in zone["reasons"])
    assert set(observer.heard("command")[-1].value["velocity"]) == {0.0}
    # The first time that anybody asks for frames: what arrived long ago is not the present.
    kind, _, value = observer.ask("frames")
    assert kind == "error"
    assert "no fresh joint state" in value["error"]


def test_another_driver_is_picked_up_once_the_first_is_silent(service, observer):
    with driving(service.endpoint, producer="first"):
        observer.until(lambda zone: zone["zone"] == "yellow")
        before = observer.health()["rejected"].get("joints", {}).get("second_producer", 0)
        with driving(service.endpoint, producer="second"):
            wait_for(
                lambda: (
                    observer.health()["rejected"].get("joints", {}).get("second_producer", 0) > before + 20
                )
            )
    with driving(service.endpoint, producer="third"):
        observer.until(lambda zone: zone["zone"] == "yellow" and zone["reasons"] == ["distance"])


def test_an_optional_source_that_was_there_and_is_gone_stops(service, observer):
    calm(observer)
    others = {source: HEALTHY[source] for source in ("joints", "ranges", "target")}
    with driving(service.endpoint, others, producer="arm"):
        with driving(service.endpoint, {"obstacles": HEALTHY["obstacles"]}, producer="camera"):
            observer.until(lambda zone: zone["reasons"] == ["distance"])
        zone = observer.until(lambda zone: zone["zone"] == "stop")
        assert zone["reasons"] == ["stale:obstacles"]
        assert zone["sources"]["obstacles"]["required"] is False


def test_a_missing_target_zeroes_the_command_and_nothing_else(service, observer):
    calm(observer)
    with driving(service.endpoint, WITHOUT_TARGET):
        zone = observer.until(lambda zone: zone["zone"] == "yellow")
        assert zone["reasons"] == ["distance", "stale:target"]
        command = observer.heard("command")[-1].value
        assert set(command["velocity"]) == {0.0}


def test_a_frozen_driver_is_stale_and_comes_back_slowly(service, observer):
    with driving(service.endpoint) as driver:
        observer.until(lambda zone: zone["reasons"] == ["distance"])
        observer.forget()
        driver.signal(signal.SIGSTOP)
        observer.until(lambda zone: "stale:joints" in zone["reasons"])
        time.sleep(0.4)
        assert observer.next_zone()["zone"] == "stop"
        observer.forget()
        driver.signal(signal.SIGCONT)
        observer.until(lambda zone: zone["reasons"] == ["distance"])
        zones = observer.zones()
        left = next(zone["seq"] for zone in zones if zone["zone"] != "stop")
        before = [zone for zone in zones if left - RECOVERY_TICKS < zone["seq"] < left]
        assert before
        assert all("recovering" in zone["reasons"] for zone in before)


def test_old_and_repeated_messages_refresh_nothing(observer):
    """A driver's backlog as far as it can be told: the same or lower ``seq`` is refused and ages go on."""
    calm(observer)
    others = {"ranges": RANGE_FIELDS, "obstacles": OBSTACLE_FIELDS}
    old = json.dumps({"producer": "looping", "seq": 500, "stamp_ns": 0, **JOINT_FIELDS})
    older = json.dumps({"producer": "looping", "seq": 499, "stamp_ns": 0, **JOINT_FIELDS})
    observer.put("in/joints", old)
    before = observer.health()["rejected"].get("joints", {}).get("old_seq", 0)
    until = time.monotonic() + 0.5
    sent = 0
    with driving_in_process(observer, **others):
        while time.monotonic() < until:
            observer.put("in/joints", old)
            observer.put("in/joints", older)
            sent += 2
            time.sleep(0.004)
        zone = observer.next_zone()
    assert zone["zone"] == "stop"
    assert zone["sources"]["joints"]["age_s"] > 0.4
    assert observer.health()["rejected"]["joints"]["old_seq"] == before + sent


def test_a_burst_of_a_drivers_backlog_counts_as_one_arrival(observer):
    """What nobody can tell: a backlog with rising ``seq`` arrives now. It is believed for one timeout."""
    calm(observer)
    others = {"ranges": RANGE_FIELDS, "obstacles": OBSTACLE_FIELDS}
    with driving_in_process(observer, **others):
        time.sleep(0.1)
        observer.forget()
        begin = time.monotonic()
        for seq in range(60):
            message = {"producer": "frozen", "seq": seq, "stamp_ns": 1, **JOINT_FIELDS}
            observer.put("in/joints", json.dumps(message))
        sent = time.monotonic()
        observer.until(lambda zone: zone["sources"]["joints"]["state"] == "fresh")
        observer.until(lambda zone: zone["sources"]["joints"]["state"] == "stale")
        states = [(one.at, one.value["sources"]["joints"]["state"]) for one in observer.heard()]
    fresh = [at for at, state in states if state == "fresh"]
    assert begin < fresh[0]
    assert fresh[-1] <= sent + 0.1 + 2 * TICK + ALLOWANCE
    words = [word for word, _ in itertools.groupby(state for _, state in states)]
    assert words[-2:] == ["fresh", "stale"]
    assert words.count("fresh") == 1


def test_nonsense_on_a_source_stops_until_a_good_message(observer):
    with driving_in_process(
        observer, joints=JOINT_FIELDS, ranges=RANGE_FIELDS, obstacles={"obstacles": [FAR]}
    ):
        observer.until(lambda zone: zone["zone"] == "green")
        observer.forget()
        for _ in range(5):  # one that a good message follows within the same tick does no harm
            observer.put("in/obstacles", b"nonsense")
            time.sleep(0.11)
        observer.until(lambda zone: zone["zone"] == "green")
    zones = {zone["seq"]: zone for zone in observer.zones()}
    invalid = [seq for seq, zone in zones.items() if "invalid:obstacles" in zone["reasons"]]
    assert len(invalid) >= 2
    for seq in invalid:
        after = [zones[later]["zone"] for later in range(seq, seq + RECOVERY_TICKS) if later in zones]
        assert set(after) == {"stop"}


def test_nearer_is_never_milder(observer):
    """An obstacle that comes and goes: the zone tightens in the very tick of the message."""
    fields = {"obstacles": [FAR]}
    with driving_in_process(observer, joints=JOINT_FIELDS, ranges=RANGE_FIELDS, obstacles=fields):
        observer.until(lambda zone: zone["zone"] == "green")
        fields["obstacles"] = [BALL]
        observer.until(lambda zone: zone["zone"] == "yellow")
        fields["obstacles"] = [{**BALL, "position": [0.3, 0.0, 0.3]}]
        observer.until(lambda zone: zone["distance"] is not None and zone["distance"] < 0.1)
        fields["obstacles"] = [FAR]
        observer.until(lambda zone: zone["zone"] == "green")
    for zone in observer.zones():
        distance = zone["distance"]
        if distance is not None and zone["zone"] == "green":
            assert distance > 0.355
        if distance is not None and zone["zone"] == "yellow":
            assert distance > 0.1775
        if zone["zone"] == "stop":
            assert set(zone["speed_limit"]) == {0.0}
