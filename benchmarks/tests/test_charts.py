"""Charts as a journal prints them: ticks that do not overlap, plain numbers, the default marked."""

from itertools import pairwise

import pytest
from PIL import Image

from benchmarks import chart

pyplot = pytest.importorskip("matplotlib.pyplot")
RANGES = [(1, 1.1), (19, 22), (340, 1280), (0.29, 0.41), (15, 41), (0.02, 5), (1e-6, 0.3), (4, 9)]


def shown(axis, side):
    """Return (position, extent) of the labels along an axis that are inside it."""
    low, high = side.get_view_interval()
    renderer = axis.figure.canvas.get_renderer()
    return [
        label.get_window_extent(renderer)
        for place, label in zip(side.get_majorticklocs(), side.get_ticklabels(), strict=True)
        if low <= place <= high and label.get_text()
    ]


@pytest.mark.parametrize("low, high", RANGES)
def test_labels_do_not_overlap(low, high):
    figure, axis = pyplot.subplots(figsize=(4.2, 3.4), layout="constrained")
    axis.plot([low, high], [low, high], "o")
    chart.log_ticks(axis)
    figure.canvas.draw()
    across, up = shown(axis, axis.xaxis), shown(axis, axis.yaxis)
    assert min(len(across), len(up)) >= 2, (len(across), len(up))
    assert all(a.x1 < b.x0 for a, b in pairwise(across))
    assert all(a.y1 < b.y0 for a, b in pairwise(up))
    pyplot.close(figure)


@pytest.mark.parametrize(
    "value, text",
    [(0.5, "0.5"), (2000, "2000"), (1e-3, "0.001"), (1e-4, "1e-4"), (2e-5, "2e-5"), (0, "0")],
)
def test_numbers_are_plain(value, text):
    assert chart.plain(value) == text


def drawn(monkeypatch, tmp_path, panels, **options):
    """Draw fronts; return the texts of the figure and the size of the picture."""
    texts = []
    real = chart.save

    def save(figure, path):
        legends = [axis.get_legend() for axis in figure.axes] + figure.legends
        texts.extend(t.get_text() for one in legends if one for t in one.get_texts())
        texts.extend(axis.get_xlabel() for axis in figure.axes)
        texts.extend(axis.get_ylabel() for axis in figure.axes)
        real(figure, path)

    monkeypatch.setattr(chart, "save", save)
    chart.draw_fronts(tmp_path / "c.png", panels, "title", **options)
    with Image.open(tmp_path / "c.png") as picture:
        assert picture.width > 300
    return texts


def test_the_default_is_named_and_axes_have_units(monkeypatch, tmp_path):
    lines = {"a": [(1.0, 0.1)], "b": [(2.0, 0.05), (3.0, 0.01)]}
    texts = drawn(monkeypatch, tmp_path, {"case": {"lines": lines}}, default="b")
    assert texts == ["a", "b (default)", "front", "time [ms]", "relative error"]
    options = {"error": "rms error [mm]", "time": "processor time", "own": True}
    panels = {
        "one": {"lines": {"a": [(1, 1)]}, "default": "a"},
        "two": {"lines": {"c": [(2, 1)], "d": [(1, 2)]}, "default": "d"},
    }
    texts = drawn(monkeypatch, tmp_path, panels, **options)
    assert texts[:5] == ["a (default)", "front", "c", "d (default)", "front"]
    assert texts[5:] == ["processor time [ms]"] * 2 + ["rms error [mm]"] * 2
