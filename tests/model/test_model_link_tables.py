"""Tables of a link are made once for each shape, and kept between runs."""

import numpy as np
import pytest

from ssm_service.model import LinkDistance, Robot, link_distance, store


@pytest.fixture
def forgetful(tmp_path, monkeypatch):
    """Return where tables are kept, with none there and none in this process."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(link_distance, "_MADE", {})
    return tmp_path / "ssm-service"


def test_links_of_one_shape_share_a_table_and_others_do_not():
    first, again = (LinkDistance(Robot.load("ur3"), "forearm_link") for _ in range(2))
    assert first.table[1] is again.table[1]
    other = LinkDistance(Robot.load("ur5"), "forearm_link")
    assert other.table[1] is not first.table[1]


def test_a_kept_table_is_the_same_and_a_damaged_one_is_made_again(forgetful, monkeypatch):
    robot = Robot.load("ur3")
    made = LinkDistance(robot, "ee_link")
    expected = [*made.table, made.near_points]
    (file,) = forgetful.iterdir()
    content = bytearray(file.read_bytes())
    content[100] ^= 1
    for number, write in enumerate((None, bytes(content), b"")):
        if write is not None:
            file.write_bytes(write)
        monkeypatch.setattr(link_distance, "_MADE", {})
        again = LinkDistance(robot, "ee_link")
        for found, wanted in zip([*again.table, again.near_points], expected, strict=True):
            np.testing.assert_array_equal(found, wanted)
            assert not found.flags.writeable
            assert found.dtype == wanted.dtype
        assert (again.distance([[0.3, 0.1, 0.2]]) == made.distance([[0.3, 0.1, 0.2]])).all(), number
    assert store.load(file.name, file.stat().st_size - 32) is not None  # mended


def test_old_tables_are_removed(forgetful, monkeypatch):
    monkeypatch.setattr(store, "MOST", 3)
    for number in range(6):
        assert store.save(f"table-{number}", bytes([number]))
    assert len(list(forgetful.iterdir())) == 3
    assert store.load("table-5", 1) == b"\x05"
