"""Figures are small files, and still tell one color from another."""

from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from marl_mm.eval.figures import save_small
from marl_mm.eval.studies.figures import PAPER_COLORS


def test_a_color_of_few_pixels_stays_what_it_is(tmp_path: Path) -> None:
    figure = Figure(figsize=(6, 4))
    axis = figure.subplots()
    for number, color in enumerate(PAPER_COLORS):
        count = 400 if number == 0 else 1
        axis.plot(np.linspace(0, 1, count), np.full(count, number), "o", ms=4, c=color)
    save_small(figure, tmp_path / "small.png")
    drawn = np.asarray(Image.open(tmp_path / "small.png").convert("RGB"), int)
    for color in PAPER_COLORS:
        wanted = np.round(255 * np.array(to_rgb(color)))
        distance = np.abs(drawn - wanted).max(axis=2)
        assert (distance <= 8).sum() >= 20
