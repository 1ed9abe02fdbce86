import numpy as np
import pytest
from PIL import ImageDraw

from caterpillar_env import SmaSpring
from caterpillar_env.drawing.overlay import Readout, annotate, spring_rgb

SPRING = SmaSpring()
GREY = np.full((240, 320, 3), 128, dtype=np.uint8)
PLAIN = Readout(1.0, 0.02, 3.0)


def changed(readout):
    return (annotate(GREY, readout, SPRING) != GREY).any(axis=2)


def test_springs_are_blue_cold_yellow_warm_and_red_hot():
    cold, warm, hot = spring_rgb(SPRING, np.array([25.0, 68.0, 120.0]))
    assert cold.argmax() == 2
    assert warm[0] > 0.9
    assert warm[1] > 0.8
    assert warm[2] < 0.3
    assert hot.argmax() == 0
    assert hot[1:].max() < 0.2


def test_colours_are_interpolated_and_clipped():
    below, cold, half, warm, hot, beyond = spring_rgb(
        SPRING, np.array([10.0, 25.0, (25 + 68) / 2, 68.0, 120.0, 500.0])
    )
    np.testing.assert_allclose(half, (cold + warm) / 2)
    np.testing.assert_allclose(below, cold)
    np.testing.assert_allclose(beyond, hot)


def test_readout_and_legend_are_in_the_upper_corners():
    marked = changed(PLAIN)
    assert marked[:60, :80].mean() > 0.3
    assert marked[:60, 200:].mean() > 0.3
    assert not marked[80:].any()
    assert GREY.std() == 0  # untouched


@pytest.mark.parametrize("width", [200, 240, 280, 300, 320, 640])
def test_legend_is_shown_only_beside_the_numbers(width):
    frame = np.full((160, width, 3), 128, dtype=np.uint8)
    longest = annotate(frame, Readout(30.0, 0.196, 104.0), SPRING)
    columns = (longest[8:22] != 128).any(axis=(0, 2))
    panels = np.count_nonzero(np.diff(columns.astype(int)) == 1)  # each begins after a plain column
    coloured = np.ptp(longest.astype(int), axis=2).max() > 100  # only the legend is coloured
    assert (panels, coloured) == ((2, True) if width >= 320 else (1, False))


def test_legend_has_the_colours_of_the_springs():
    legend = annotate(GREY, PLAIN, SPRING)[:70, 160:].reshape(-1, 3) / 255
    for rgb in spring_rgb(SPRING, np.array([25.0, 68.0, 120.0])):
        assert np.abs(legend - rgb).max(axis=1).min() < 0.06


def test_numbers_have_units(monkeypatch):
    written, write = [], ImageDraw.ImageDraw.text

    def record(self, at, text, **look):
        written.append(text)
        write(self, at, text, **look)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", record)
    spring = SmaSpring(ambient_c=21.0)  # its legend is not cached
    annotate(GREY, Readout(12.34, -0.0218, 45.6, "veered", "robot"), spring)
    assert written == [
        "springs", "21", "68", "120 °C",
        "robot", "12.3 s    -22 mm    46 J", "veered at 12.3 s",
    ]  # fmt: skip


def test_failure_is_written_in_red():
    def red(readout):
        picture = annotate(GREY, readout, SPRING)[:, :140].astype(int)
        return ((picture[..., 0] > 150) & (picture[..., 1] < 80)).sum()

    assert red(PLAIN) == 0
    assert red(PLAIN._replace(failure="veered")) > 20


def test_long_title_stays_clear_of_the_legend():
    titled = annotate(GREY, PLAIN._replace(title="m" * 500), SPRING)
    np.testing.assert_array_equal(titled[:, 190:], annotate(GREY, PLAIN, SPRING)[:, 190:])
    assert changed(PLAIN._replace(title="m" * 500))[:, :150].sum() > changed(PLAIN)[:, :150].sum()


@pytest.mark.parametrize("size", [(48, 64), (64, 64), (64, 200), (400, 64)])
def test_small_frames_keep_their_size(size):
    frame = np.zeros((*size, 3), dtype=np.uint8)
    drawn = annotate(frame, PLAIN._replace(title="robot", failure="tipped"), SPRING)
    assert drawn.shape == frame.shape
    assert not drawn[:, 160:].any()  # no room for the legend
