"""Tables and figures of ablations of offline learning, from rows; and their check."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib

from marl_mm.errors import MarlMmError
from marl_mm.eval.ablations import Ablation, Cell
from marl_mm.eval.metrics import Row
from marl_mm.eval.offline import ablation_lines, summarize_ablation
from marl_mm.eval.offline_figures import curves_figure
from marl_mm.eval.offline_rows import RowStore
from marl_mm.eval.rows import write_csv
from marl_mm.eval.tables import latex_table, markdown_table
from marl_mm.files import new_file

_FIGURES = (".png", ".svg")

_DRAWN_WITH = "drawn_with.txt"
"""In the folder of results: the version of Matplotlib that drew them."""


def drawings(name: str, ablation: Ablation) -> list[str]:
    """Files that an ablation is drawn to."""
    tables = [f"{name}{end}" for end in (".csv", ".md", ".tex")]
    return tables + [f"{name}{end}" for end in _FIGURES if ablation.figure]


def draw(
    name: str,
    ablation: Ablation,
    store: RowStore,
    seeds: Sequence[int],
    results: Path,
) -> tuple[list[Row], str]:
    """Write an ablation's table, and its figure if it has one.

    Returns:
        The table's rows, and its text.
    """

    def evaluations(cell: Cell) -> list[Row]:
        return store.evaluations(cell, seeds, ablation.probes)

    def curves(cell: Cell) -> list[Row]:
        return store.curves(cell, seeds)

    summary = summarize_ablation(ablation, evaluations)
    lines = ablation_lines(ablation, summary)
    text = markdown_table(*lines)
    write_csv(results / f"{name}.csv", summary)
    about = f"# {ablation.about}\n\n{text}"
    for end, contents in ((".md", about), (".tex", latex_table(*lines))):
        with new_file(results / f"{name}{end}") as temporary:
            temporary.write_text(contents)
    if ablation.figure:
        curves_figure(ablation, curves, results / name)
        with new_file(results / _DRAWN_WITH) as temporary:
            temporary.write_text(f"matplotlib {matplotlib.__version__}\n")
    return summary, text


def check_drawings(
    ablations: Mapping[str, Ablation],
    store: RowStore,
    seeds: Sequence[int],
    results: Path,
) -> None:
    """Say of every file whether it is what its rows give, to the byte.

    Raises:
        MarlMmError: If one is not. Figures may differ that another Matplotlib drew.
    """
    drawn_with = results / _DRAWN_WITH
    here = f"matplotlib {matplotlib.__version__}\n"
    other_artist = drawn_with.exists() and drawn_with.read_text() != here
    wrong = []
    with TemporaryDirectory() as folder:
        for name, ablation in ablations.items():
            draw(name, ablation, store, seeds, Path(folder))
            for file in drawings(name, ablation):
                known = results / file
                same = known.exists() and (
                    known.read_bytes() == Path(folder, file).read_bytes()
                )
                excused = not same and other_artist and known.suffix in _FIGURES
                told = "the same" if same else "another"
                if excused:
                    told = f"not compared, drawn with {drawn_with.read_text().strip()}"
                print(f"{known}: {told if known.exists() else 'missing'}")
                if not same and not excused:
                    wrong.append(str(known))
    if wrong:
        raise MarlMmError(
            f"{', '.join(wrong)}: not what {store.folder} gives; draw again with "
            "--overwrite"
        )
