"""Tables of a link are made once for each shape."""

from ssm_service.model import LinkDistance, Robot


def test_links_of_one_shape_share_a_table_and_others_do_not():
    first, again = (LinkDistance(Robot.load("ur3"), "forearm_link") for _ in range(2))
    assert first.table[1] is again.table[1]
    other = LinkDistance(Robot.load("ur5"), "forearm_link")
    assert other.table[1] is not first.table[1]
