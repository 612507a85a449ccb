"""The latch: the second error within the interval, and nothing else, until somebody resets it."""

from __future__ import annotations

import itertools
import random

import pytest

from ssm_service.wire.latch import IntegrityError, Latch

INTERVAL = 10.0


def test_one_error_is_remembered_and_latches_nothing():
    latch = Latch(INTERVAL)
    assert latch.error("corruption", "in/joints", 1.0)
    assert (latch.latched, str(latch.last)) == (None, "corruption on in/joints")


@pytest.mark.parametrize("after", [0.0, 9.9, 10.0])
def test_the_second_within_the_interval_latches(after):
    latch = Latch(INTERVAL)
    latch.error("corruption", "in/joints", 1.0)
    assert latch.error("insertion", "in/ranges", 1.0 + after)
    assert latch.latched == f"insertion on in/ranges, {after:.1f} s after corruption on in/joints"


def test_one_later_begins_a_new_interval():
    latch = Latch(INTERVAL)
    latch.error("corruption", "in/joints", 1.0)
    latch.error("corruption", "in/joints", 11.001)
    assert latch.latched is None
    latch.error("corruption", "in/joints", 21.0)
    assert latch.latched is not None


def test_a_clock_that_goes_back_makes_no_interval_longer():
    latch = Latch(INTERVAL)
    latch.error("corruption", "in/joints", 100.0)
    latch.error("sequence", "in/joints", 5.0)
    assert latch.latched == "sequence on in/joints, 0.0 s after corruption on in/joints"


def test_what_is_latched_stays_so_whatever_comes():
    latch = Latch(INTERVAL, latched="before")
    assert not latch.error("corruption", "in/joints", 1.0)
    assert not latch.error("corruption", "in/joints", 1e9)
    assert (latch.latched, latch.last) == ("before", None)


def test_a_reset_forgets_everything_and_says_what():
    latch = Latch(INTERVAL)
    assert latch.reset() is None
    latch.error("corruption", "in/joints", 1.0)
    assert latch.reset() == "corruption on in/joints"
    latch.error("corruption", "in/joints", 1.1)
    assert latch.latched is None
    latch.error("corruption", "in/joints", 1.2)
    assert latch.reset() == "corruption on in/joints, 0.1 s after corruption on in/joints"
    assert (latch.latched, latch.last) == (None, None)


def test_an_error_from_before_a_restart_counts():
    latch = Latch(INTERVAL, last=IntegrityError(fault="masquerade", where="in/target", at_s=-3.0))
    latch.error("corruption", "in/joints", 1.0)
    assert latch.latched == "corruption on in/joints, 4.0 s after masquerade on in/target"


def test_it_latches_exactly_where_two_neighbours_lie_within_the_interval():
    choose = random.Random(5)
    for _ in range(500):
        times = sorted(choose.uniform(0.0, 60.0) for _ in range(choose.randrange(8)))
        latch = Latch(INTERVAL)
        for at in times:
            latch.error("corruption", "x", at)
        near = any(b - a <= INTERVAL for a, b in itertools.pairwise(times))
        assert (latch.latched is not None) == near
