"""Drawings as SVG text: boxes, arrows, words, and plots of a few curves."""

import math
from collections.abc import Sequence
from html import escape

INK, FAINT, PAPER = "#263238", "#90a4ae", "#ffffff"
COLOURS = ("#1565c0", "#c62828", "#2e7d32", "#6a1b9a")
"""Colours of curves and agents, in order."""

Point = tuple[float, float]


def drawing(width: int, height: int, parts: Sequence[str], about: str) -> str:
    """An SVG file: white paper, so that it is read on dark pages, too."""
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}" role="img" '
        f'font-family="Helvetica, Arial, sans-serif" font-size="14" fill="{INK}">\n'
        f"<title>{escape(about)}</title>\n"
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" '
        'markerWidth="7" markerHeight="7" orient="auto">'
        f'<path d="M0 0 L8 4 L0 8 z" fill="{INK}"/></marker></defs>\n'
        f'<rect width="{width}" height="{height}" rx="6" fill="{PAPER}"/>\n'
        f"{body}\n</svg>\n"
    )


def words(
    x: float,
    y: float,
    *lines: str,
    size: int = 14,
    anchor: str = "start",
    colour: str = INK,
    bold: bool = False,
) -> str:
    """Lines of text, the first one's baseline at y."""
    weight = ' font-weight="bold"' if bold else ""
    spans = "".join(
        f'<tspan x="{x:g}" dy="{size * 1.3 if i else 0:g}">{escape(line)}</tspan>'
        for i, line in enumerate(lines)
    )
    return (
        f'<text x="{x:g}" y="{y:g}" font-size="{size}" text-anchor="{anchor}" '
        f'fill="{colour}"{weight}>{spans}</text>'
    )


def box(
    x: float,
    y: float,
    width: float,
    height: float,
    title: str,
    *lines: str,
    colour: str = INK,
) -> str:
    """A box with a title and lines."""
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6" '
        f'fill="{colour}" fill-opacity="0.06" stroke="{colour}" stroke-width="1.5"/>'
        + words(x + 12, y + 24, title, size=15, colour=colour, bold=True)
        + words(x + 12, y + 47, *lines, size=13)
    )


def frame(x: float, y: float, width: float, height: float, title: str) -> str:
    """A faint frame around boxes, with a title."""
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6" '
        f'fill="{FAINT}" fill-opacity="0.12" stroke="{FAINT}"/>'
        + words(x + 14, y + 22, title, size=13, colour="#546e7a", bold=True)
    )


def arrow(*points: Point, dashed: bool = False) -> str:
    """A line through points with a tip at its end."""
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    dash = ' stroke-dasharray="5 4"' if dashed else ""
    return (
        f'<polyline points="{path}" fill="none" stroke="{INK}" stroke-width="1.5" '
        f'marker-end="url(#tip)"{dash}/>'
    )


def line(
    points: Sequence[Point], colour: str = INK, width: float = 1.5, opacity: float = 1.0
) -> str:
    """A line through points."""
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    return (
        f'<polyline points="{path}" fill="none" stroke="{colour}" '
        f'stroke-width="{width:g}" stroke-opacity="{opacity:g}" '
        'stroke-linejoin="round"/>'
    )


class Plot:
    """Axes in a rectangle, and curves in them.

    Args:
        place: Left, top, width and height of the axes [px].
        x: Least and largest value along x.
        y: Least and largest value along y.
        labels: What the axes show.
    """

    def __init__(
        self,
        place: tuple[float, float, float, float],
        x: Point,
        y: Point,
        labels: tuple[str, str],
    ) -> None:
        self._place, self._x, self._y = place, x, y
        left, top, width, height = place
        self.parts = [
            words(left + width / 2, top + height + 38, labels[0], anchor="middle"),
            f'<g transform="translate({left - 44:g} {top + height / 2:g}) rotate(-90)">'
            + words(0, 0, labels[1], anchor="middle")
            + "</g>",
        ]
        for value in _ticks(*x):
            px, _ = self.at(value, y[0])
            label = f"{value:,g}"
            self.parts.append(
                words(px, top + height + 18, label, size=12, anchor="middle")
            )
        for value in _ticks(*y):
            _, py = self.at(x[0], value)
            self.parts += [
                line([(left, py), (left + width, py)], FAINT, 0.5),
                words(left - 6, py + 4, f"{value:g}", size=12, anchor="end"),
            ]
        corner = [(left, top), (left, top + height), (left + width, top + height)]
        self.parts.append(line(corner, INK, 1))

    def at(self, x: float, y: float) -> Point:
        """Where a value is drawn."""
        left, top, width, height = self._place
        (x0, x1), (y0, y1) = self._x, self._y
        return left + (x - x0) / (x1 - x0) * width, top + (y1 - y) / (y1 - y0) * height

    def curve(self, points: Sequence[Point], colour: str, faint: bool = False) -> None:
        """Draw a curve."""
        placed = [self.at(x, y) for x, y in points]
        self.parts.append(line(placed, colour, *((1, 0.35) if faint else (2.5, 1.0))))


def _ticks(least: float, most: float) -> list[float]:
    """Round numbers between two, four to eight of them."""
    step = 10.0 ** math.floor(math.log10((most - least) / 4))
    step *= next(n for n in (1, 2, 2.5, 5, 10) if (most - least) / (step * n) <= 8)
    first, last = math.ceil(least / step - 1e-9), math.floor(most / step + 1e-9)
    return [round(i * step, 10) for i in range(first, last + 1)]
