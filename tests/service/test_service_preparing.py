"""Scans that take long are prepared beside the loop: newest first, never younger than they are."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from ssm_service.errors import SsmError
from ssm_service.monitor import PreparedScan
from ssm_service.service.preparing import ScanPreparation


class SlowReader:
    """Prepares a scan when it is let to."""

    def __init__(self) -> None:
        self.go = threading.Semaphore(0)
        self.asked: list[float] = []

    def prepare(self, ranges, position):
        self.asked.append(float(ranges[0]))
        assert self.go.acquire(timeout=10.0)
        if ranges[0] < 0.0:
            raise SsmError("cannot be done")
        return PreparedScan(ranges=ranges, masked=None, whole=None)  # type: ignore[arg-type]


@pytest.fixture
def reader():
    return SlowReader()


def until(condition, timeout_s=10.0):
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.001)
    raise AssertionError("it did not come about in time")


def test_the_newest_scan_is_prepared_and_keeps_its_age(reader):
    told: list[str] = []
    preparation = ScanPreparation(reader, told.append)
    position = np.zeros(6)
    preparation.submit(np.array([1.0]), position, 100)
    until(lambda: reader.asked == [1.0])
    for number, arrived in ((2.0, 200), (3.0, 300)):
        preparation.submit(np.array([number]), position, arrived)
    assert preparation.take() is None
    reader.go.release()
    first = until(preparation.take)
    assert (first.prepared.ranges[0], first.arrived_ns) == (1.0, 100)
    assert preparation.take() is None
    reader.go.release()
    last = until(preparation.take)
    assert (last.prepared.ranges[0], last.arrived_ns) == (3.0, 300)
    assert reader.asked == [1.0, 3.0]
    assert told == []


def test_a_scan_that_fails_is_told_and_the_next_one_is_taken(reader):
    told: list[str] = []
    preparation = ScanPreparation(reader, told.append)
    reader.go.release()
    preparation.submit(np.array([-1.0]), np.zeros(6), 1)
    until(lambda: told == ["cannot be done"])
    assert preparation.take() is None
    reader.go.release()
    preparation.submit(np.array([5.0]), np.zeros(6), 2)
    assert until(preparation.take).arrived_ns == 2
