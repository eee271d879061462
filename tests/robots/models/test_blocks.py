import pytest

from robots.models.blocks import BLOCK, BLOCK_JOINTS, block_rows


@pytest.mark.parametrize(("n", "width"), [(1, BLOCK), (6, BLOCK), (12, BLOCK), (13, 14), (50, 3), (128, 1)])
def test_robots_of_many_joints_have_blocks_of_few(n, width):
    rows = block_rows(2 * width, n)
    assert rows == [slice(0, width), slice(width, 2 * width)]
    assert width == BLOCK or n * width <= BLOCK_JOINTS < n * (width + 1)


@pytest.mark.parametrize("n", [6, 50, 128])
@pytest.mark.parametrize("robots", [1, 2, 7, 37])
def test_blocks_of_one_width_hold_every_robot(robots, n):
    rows = block_rows(robots, n)
    assert {each.stop - each.start for each in rows} == {rows[0].stop}
    assert {row for each in rows for row in range(each.start, each.stop)} == set(range(robots))
