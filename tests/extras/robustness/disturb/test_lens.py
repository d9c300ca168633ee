import numpy as np
import pytest

from omniocc.extras.robustness.disturb.lens import DIRT_RGB, behind_dirt, draw_dirt, draw_drops, through_drops

SEEN = np.zeros((72, 128), bool)
SEEN[:, 16:112] = True
IMAGE = np.random.default_rng(0).integers(0, 256, (72, 128, 3), dtype=np.uint8) * SEEN[..., None]


@pytest.mark.parametrize("percent", [20, 60])
def test_drops_cover_this_much_of_what_the_lens_sees_and_stay_where_they_are(percent):
    drops = draw_drops(SEEN, percent, np.random.default_rng(3))
    covered = 100 * (drops.cover[SEEN] > 0.5).mean()
    assert percent <= covered < percent + 3
    assert not drops.cover[~SEEN].any()
    again = draw_drops(SEEN, percent, np.random.default_rng(3))
    assert all(map(np.array_equal, drops, again))


def test_a_drop_turns_its_view_upside_down():
    seen = np.ones((100, 100), bool)
    drops = draw_drops(seen, 0.1, np.random.default_rng(0))  # one drop
    rows, columns = np.nonzero(drops.cover > 0.99)
    top, bottom = rows.argmin(), rows.argmax()
    assert rows[bottom] > rows[top]
    assert drops.row[rows[bottom], columns[bottom]] < drops.row[rows[top], columns[top]]
    image = np.zeros((100, 100, 3), np.uint8)
    image[50:] = 200
    shown = through_drops(image, drops)
    np.testing.assert_array_equal(shown[drops.cover == 0], image[drops.cover == 0])
    assert (shown[drops.cover > 0.99] != image[drops.cover > 0.99]).any() or not (45 < rows.mean() < 55)


@pytest.mark.parametrize("percent", [20, 60])
def test_dirt_hides_this_much(percent):
    dirt = draw_dirt(SEEN, percent, np.random.default_rng(2))
    assert 100 * (dirt[SEEN] > 0.5).mean() == pytest.approx(percent, abs=0.5)
    assert not dirt[~SEEN].any()
    shown = behind_dirt(IMAGE, dirt)
    assert (shown[dirt == 1] == DIRT_RGB).all()
    np.testing.assert_array_equal(shown[dirt == 0], IMAGE[dirt == 0])
    assert (dirt == 1).any()
    assert (dirt[SEEN] == 0).any()
