"""The kept table of single echoes: the same to the last bit, never believed when damaged, never an error."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ssm_service.config import AssumptionsConfig
from ssm_service.model import LinkDistance, Robot, store
from ssm_service.perception import LowerBound
from ssm_service.perception import bound as bound_module

BASE = {"radius_min_m": 0.05, "radius_max_m": 0.1, "reading_error_m": 0.01, "obstacles": "one"}
ASSUMED = AssumptionsConfig(**BASE)
PER_SENSOR = ("indices", "transforms_sensor_to_link", "half_angles", "ranges_min", "ranges_max")


@pytest.fixture(scope="module")
def parts():
    robot = Robot.load("ur3")
    array = robot.sensor_arrays[0]
    two = {name: getattr(array, name)[:2] for name in PER_SENSOR}
    two["ranges_max"] = np.full(2, 0.1)
    surface = LinkDistance(robot, array.link)
    assert surface.table  # made, and kept, before the tests look at what is kept
    return replace(array, **two), surface


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "ssm-service"


def changed(**values):
    return AssumptionsConfig(**(BASE | values))


def scans():
    places = np.random.default_rng(1).uniform(0.0, 0.11, 40)
    return np.array([[place, math.inf] for place in places] + [[math.inf, place] for place in places])


def compiled_forms():
    from ssm_service.perception import bound_box, bound_hidden, bound_readings, bound_search, bound_solve

    modules = bound_box, bound_hidden, bound_readings, bound_search, bound_solve
    named = (item for module in modules for item in vars(module).items())
    return {name: len(f.signatures) for name, f in named if hasattr(f, "signatures")}


def test_same_with_and_without_a_table(parts, cache):
    without = LowerBound(*parts, ASSUMED, kept=False)
    expected = without.of_many(scans())
    first = LowerBound(*parts, ASSUMED)
    assert first.fill()
    assert len(list(cache.iterdir())) == 1
    loaded = LowerBound(*parts, ASSUMED)
    assert loaded.fill(lambda: pytest.fail("nothing was left to do"))
    for bound in (first, loaded):
        np.testing.assert_array_equal(bound.of_many(scans()), expected)
    for scan in scans()[::9]:
        one, other = without.of(scan), loaded.of(scan)
        assert (one.distance, one.radius) == (other.distance, other.radius)
        np.testing.assert_array_equal(one.centre, other.centre)


def test_damage_is_never_believed(parts, cache):
    bound = LowerBound(*parts, ASSUMED)
    assert bound.fill()
    (file,) = cache.iterdir()
    good = file.read_bytes()
    size = len(good) - 32
    assert store.load(file.name, size) == good[32:]
    flipped = good[:5000] + bytes([good[5000] ^ 1]) + good[5001:]
    for content in (flipped, good[:-8], b"", good + b"0"):
        file.write_bytes(content)
        assert store.load(file.name, size) is None
        np.testing.assert_array_equal(LowerBound(*parts, ASSUMED).of_many(scans()), bound.of_many(scans()))
    (cache / "other").write_bytes(good)  # another robot's table under this name
    assert store.load("other", size) is None


def test_another_assumption_has_another_table(parts, cache):
    assert LowerBound(*parts, ASSUMED).fill()
    (file,) = cache.iterdir()
    asked = []
    other = LowerBound(*parts, changed(reading_error_m=0.011))
    assert not other.fill(lambda: bool(asked.append(1)))
    assert asked
    assert list(cache.iterdir()) == [file]


def test_no_place_is_no_error(parts, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert LowerBound(*parts, ASSUMED).fill()
    assert not store.save("x", b"123")


def test_ends_when_told_and_makes_none_for_many(parts, cache):
    assert not LowerBound(*parts, ASSUMED).fill(lambda: False)
    assert not LowerBound(*parts, changed(obstacles="many")).fill()
    assert not cache.exists()


def test_a_process_goes_on_where_another_was_ended(parts, cache, monkeypatch):
    monkeypatch.setattr(bound_module, "_KEPT_EVERY", 1)
    budget = iter([True] * 5 + [False])
    assert not LowerBound(*parts, ASSUMED).fill(lambda: next(budget))
    asked: list[int] = []
    assert LowerBound(*parts, ASSUMED).fill(lambda: not asked.append(1))
    whole: list[int] = []
    assert LowerBound(*parts, ASSUMED, kept=False).fill(lambda: not whole.append(1))
    assert len(asked) == len(whole) - 5
    expected = LowerBound(*parts, ASSUMED, kept=False).of_many(scans())
    np.testing.assert_array_equal(LowerBound(*parts, ASSUMED).of_many(scans()), expected)


def test_nothing_compiles_after_the_constructor(parts):
    for obstacles in ("one", "many"):
        bound = LowerBound(*parts, changed(obstacles=obstacles))
        before = compiled_forms()
        bound.of([0.05, 0.06])
        bound.of([0.05, 0.06], [True, False])
        bound.of([math.inf, 0.06], [True, True])
        bound.of_many(scans())
        bound.fill(lambda: False)
        assert compiled_forms() == before
