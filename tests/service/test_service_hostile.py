"""Nothing that anyone sends crashes the service, stops its clock or makes a zone milder."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh
from hostile import hostile
from service_kit import (
    HEALTHY,
    JOINT_FIELDS,
    POSITION,
    SEVERITY,
    Ear,
    ServiceUnderTest,
    driving,
    listening,
    running,
    strictly,
    wait_for,
)

EACH = 10_000


@pytest.fixture(scope="module")
def service() -> Iterator[ServiceUnderTest]:
    """A service with a healthy driver: by its data alone the zone is yellow."""
    with running() as service, driving(service.endpoint):
        yield service


@pytest.fixture
def watcher(service: ServiceUnderTest) -> Iterator[Ear]:
    """Hears every zone during a test; none of them may be milder than yellow."""
    with listening(service.endpoint) as ear:
        ear.until(lambda zone: zone["reasons"] == ["distance"])
        ear.forget()
        pid, first = service.pid, ear.health()
        yield ear
        zone = ear.until(lambda zone: zone["reasons"] == ["distance"], seconds=20.0)  # by itself
        assert zone["zone"] == "yellow"
        # The stranger's own words on our key are no zones.
        zones = [strictly(one.text) for one in ear.heard() if one.text != b"stranger"]
        assert min(SEVERITY[zone["zone"]] for zone in zones) == SEVERITY["yellow"]
        assert {zone["producer"] for zone in zones} == {first["producer"]}
        seqs = [zone["seq"] for zone in zones]
        assert seqs == sorted(set(seqs))
        last = ear.health()
        assert (service.pid, service.popen.poll()) == (pid, None)
        assert last["producer"] == first["producer"]


@pytest.fixture
def stranger(service: ServiceUnderTest) -> Iterator[Ear]:
    with listening(service.endpoint, listen=False) as ear:
        yield ear


def refusals(health: dict[str, Any], source: str) -> int:
    return sum(health["rejected"].get(source, {}).values())


def test_ten_thousand_hostile_messages_on_every_key_at_full_speed(service, watcher, stranger):
    messages = {source: hostile(source, EACH, seed) for seed, source in enumerate(HEALTHY)}
    before, memory, files = watcher.health(), service.memory(), service.files()
    begin = time.monotonic()
    for index in range(EACH):
        for source, batch in messages.items():
            payload, attachment = batch[index]
            stranger.put(f"in/{source}", payload, attachment=attachment)
    sent = time.monotonic() - begin

    def counted() -> bool:
        now = watcher.health()
        return all(refusals(now, source) - refusals(before, source) >= EACH for source in HEALTHY)

    wait_for(counted, 40.0, "every hostile message counted")
    after = watcher.health()
    assert min(after["integrity_errors"][fault] for fault in ("corruption", "masquerade", "insertion")) > 1000
    assert after["latched"] is None  # this profile has no latch
    for source in HEALTHY:
        assert refusals(after, source) - refusals(before, source) == EACH
        causes = {"not_json", "wrong_type", "unknown_field", "out_of_range", "second_producer", "too_large"}
        causes |= {"missing_crc", "bad_attachment", "corrupt"}
        assert causes <= set(after["rejected"][source])
        assert len(after["rejected"][source]) < 25
        assert len(after["last_rejection"][source]) <= 300
    watcher.until(lambda zone: zone["reasons"] == ["distance"], seconds=20.0)
    ticks = after["ticks"] - before["ticks"]
    print(
        f"{4 * EACH} messages in {sent:.1f} s; lateness p50 {before['lateness_us']['p50']:.1f} µs before, "
        f"{after['lateness_us']['p50']:.1f} µs after; {ticks} ticks, {after['skipped'] - before['skipped']} "
        f"skipped; memory {(service.memory() - memory) / 1e6:+.1f} MB"
    )
    assert ticks > 0.5 * 500 * sent
    assert service.memory() - memory < 150e6
    assert service.files() <= files + 4


def test_a_flood_that_holds_up_the_driver_lets_nobody_else_in(watcher, stranger):
    """Well-made messages of a stranger, to be read while the good driver's wait behind nonsense."""
    milder = json.dumps({"producer": "patient", "seq": 1, "stamp_ns": 0, "obstacles": []})
    until = time.monotonic() + 2.0
    index = 0
    while time.monotonic() < until:
        stranger.put("in/obstacles", milder if index % 500 == 0 else b"[" * 5000)
        index += 1
    watcher.until(lambda zone: zone["reasons"] == ["distance"], seconds=20.0)
    assert watcher.health()["rejected"]["obstacles"]["second_producer"] > 0


def test_deletes_wrong_encodings_and_wildcards(watcher, stranger):
    before = watcher.health()
    for source in HEALTHY:
        stranger.session.delete(f"ssm/ur3/in/{source}")
    wait_for(lambda: all(watcher.health()["rejected"].get(s, {}).get("not_put", 0) for s in HEALTHY))
    for key in ("ssm/ur3/in/*", "ssm/*/in/joints", "ssm/ur3/in/**", "**/joints"):
        stranger.session.put(key, b"[]")
    for encoding in (
        zenoh.Encoding.APPLICATION_CBOR,
        "application/json;ssm.Zone/1",
        "text/plain;charset=koi8",
    ):
        stranger.session.put("ssm/ur3/in/joints", b"[]", encoding=encoding)

    def joints() -> int:
        return refusals(watcher.health(), "joints") - refusals(before, "joints")

    wait_for(lambda: joints() == 1 + 4 + 3)
    assert watcher.health()["rejected"]["joints"]["wrong_encoding"] == 1
    assert refusals(watcher.health(), "target") - refusals(before, "target") == 1 + 2


@pytest.mark.parametrize("size", [100_000, 3_000_000, 5_000_000])
def test_messages_of_any_size(watcher, service, size):
    """Up to Zenoh's own limit they are counted; beyond it Zenoh ends the sender's link, and only that."""
    before = refusals(watcher.health(), "joints")
    with listening(service.endpoint, listen=False) as sender:
        for _ in range(5):
            sender.put("in/joints", b"x" * size)
        if size < 4_000_000:
            wait_for(lambda: refusals(watcher.health(), "joints") == before + 5)
        time.sleep(0.2)
    assert service.memory() < 1.5e9


def test_a_stranger_on_our_own_outputs_is_a_duplicate_and_never_mixed(watcher, stranger):
    for key in ("zone", "command"):
        watcher.until(lambda zone: zone["reasons"] == ["distance"])
        stranger.session.put(f"ssm/ur3/{key}", b"stranger")
        zone = wait_for(
            lambda: [strictly(one.text) for one in watcher.heard() if b"duplicate:service" in one.text]
        )[0]
        assert zone["zone"] == "stop"
        assert watcher.ask("zone")[2]["producer"] == zone["producer"]
        watcher.until(lambda zone: zone["reasons"] == ["distance"])
        watcher.forget()
    assert any("another service" in text for text in watcher.health()["warnings"])


def test_a_flood_of_queries_for_the_zone_holds_up_nothing(watcher, stranger):
    before = watcher.health()
    answered = []
    for _ in range(5000):
        stranger.session.get("ssm/ur3/zone", lambda reply: answered.append(reply.ok is not None), timeout=5.0)
    wait_for(lambda: len(answered) > 200)
    wait_for(lambda: watcher.ask("zone")[0] == "ok")
    after = watcher.health()
    assert all(answered)
    assert after["queries"]["zone"] - before["queries"]["zone"] > 200
    print(f"{len(answered)} answered, skipped {after['skipped'] - before['skipped']}")


def test_queriers_that_die_while_they_wait_harm_nobody(watcher, service):
    script = (
        "import json, os, sys, zenoh\n"
        "c = zenoh.Config(); c.insert_json5('mode', '\"client\"')\n"
        "c.insert_json5('connect/endpoints', json.dumps([sys.argv[1]]))\n"
        "s = zenoh.open(c)\n"
        "for _ in range(300):\n"
        "    for key in ('zone', 'health', 'frames', 'evaluate'):\n"
        "        s.get('ssm/ur3/' + key, zenoh.handlers.FifoChannel(1000), payload=sys.argv[2])\n"
        "os.kill(os.getpid(), 9)\n"
    )
    payload = json.dumps([{"position": POSITION}] * 20)
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", script, service.endpoint, payload], timeout=30)
        assert done.returncode == -9
    assert watcher.ask("zone")[0] == "ok"
    wait_for(lambda: watcher.ask("evaluate", payload, seconds=10.0)[0] == "ok", 10.0)


def test_more_questions_than_can_wait_are_told_so(watcher, stranger):
    heavy = json.dumps([{"position": POSITION}] * 600)
    replies: list[tuple[bool, bytes]] = []
    lock = threading.Lock()

    def take(reply: zenoh.Reply) -> None:
        content = reply.ok or reply.err
        with lock:
            replies.append((reply.ok is not None, content.payload.to_bytes()))

    count, heavies = 150, 4
    for _ in range(heavies):
        stranger.session.get("ssm/ur3/evaluate", take, payload=heavy, timeout=20.0)
    for _ in range(count - heavies):
        stranger.session.get("ssm/ur3/evaluate", take, payload=b"garbage", timeout=20.0)
    wait_for(lambda: len(replies) == count, 20.0)
    busy = [text for ok, text in replies if not ok and b"busy" in text]
    garbage = [text for ok, text in replies if not ok and b"not" not in text and b"JSON" in text]
    print(f"{len(busy)} busy, {len(garbage)} told that it is no JSON")
    assert 0 < len(busy) < count
    assert sum(ok for ok, _ in replies) == heavies
    assert watcher.ask("evaluate", json.dumps([{"position": POSITION}]))[0] == "ok"


def test_a_copy_of_the_drivers_last_message_is_old(watcher, stranger):
    """Replayed as it was heard, every message is refused: its number is taken."""
    heard: list[tuple[bytes, bytes]] = []
    with stranger.session.declare_subscriber(
        "ssm/ur3/in/joints",
        lambda sample: heard.append((sample.payload.to_bytes(), sample.attachment.to_bytes())),
    ):
        wait_for(lambda: len(heard) > 20)
    first = watcher.health()
    before = first["rejected"].get("joints", {}).get("old_seq", 0)
    for text, attachment in heard[:20]:
        assert json.loads(text)["name"] == JOINT_FIELDS["name"]
        stranger.put("in/joints", text, attachment=attachment)
    wait_for(lambda: watcher.health()["rejected"]["joints"].get("old_seq", 0) == before + 20)
    errors = watcher.health()["integrity_errors"]
    faults = sum(errors.get(fault, 0) for fault in ("repetition", "sequence"))
    assert faults == 20 + sum(first["integrity_errors"].get(fault, 0) for fault in ("repetition", "sequence"))
