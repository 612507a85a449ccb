from __future__ import annotations

from collections.abc import Iterator

import pytest
from service_kit import Ear, Process, ServiceUnderTest, driving, listening, running


@pytest.fixture(scope="session")
def shared_service() -> Iterator[ServiceUnderTest]:
    """One service for all tests that leave it as it was."""
    with running(seconds=1200) as service:
        yield service


@pytest.fixture(scope="session")
def shared_driver(shared_service: ServiceUnderTest) -> Iterator[Process]:
    with driving(shared_service.endpoint) as driver:
        yield driver


@pytest.fixture
def ear(shared_service: ServiceUnderTest, shared_driver: Process) -> Iterator[Ear]:
    """A client of the shared service, once its zone is the healthy driver's."""
    with listening(shared_service.endpoint) as ear:
        ear.until(lambda zone: zone["zone"] == "yellow" and zone["reasons"] == ["distance"])
        ear.forget()
        yield ear
