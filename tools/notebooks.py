"""Executes the notebooks of docs/notebooks, and keeps their outputs, small, with them.

``python tools/notebooks.py [--check] [NAME ...]``, in a clone with the extra ``dev``. Each
runs in an empty folder of its own, with datasets of its own; ``--check`` keeps nothing,
and makes the numbers small that say how long something takes.
"""

import base64
import io
import os
import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from PIL import Image

NOTEBOOKS = Path(__file__).resolve().parents[1] / "docs/notebooks"
WIDTH = 900
"""Largest width of a picture that is kept [px]."""

SMALL = {
    **dict.fromkeys(("steps", "updates", "curve_every"), 40),
    **dict.fromkeys(("goals", "episodes", "eval_episodes"), 2),
    **dict.fromkeys(("curve_goals", "curve_episodes", "fps", "workers"), 1),
}
"""How long things take in a check."""

PICTURE = re.compile(r"data:image/png;base64,([\w+/=\s]+)")


def small_code(code: str) -> str:
    """A cell with small numbers: arguments, entries, and steps of a mix."""
    for name, value in SMALL.items():
        code = re.sub(rf"\b({name}\"?[=:] ?)[\d_]+", rf"\g<1>{value}", code)
    inside = r"(?:[^()]|\([^()]*\))*?"
    for name, steps in (("train", 4), ("play", 2)):
        call = rf"(marl_mm\.{name}\({inside}),?\s*\)"
        code = re.sub(call, rf"\g<1>, max_steps={steps})", code)
    code = re.sub(r'("curve_goals": \d+)', r'\g<1>, "max_steps": 4', code)
    return re.sub(r"(\b[a-z]+-[a-z]+:)\d+", rf"\g<1>{SMALL['steps']}", code)


def execute(path: Path, small: bool = False) -> Any:
    """A notebook after its cells were run, as they are or with small numbers.

    Raises:
        CellExecutionError: If one of them fails.
    """
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if small and cell.cell_type == "code":
            cell.source = small_code(cell.source)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["MINARI_DATASETS_PATH"] = f"{folder}/datasets"
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=300, resources=resources).execute()
    return nbformat.reads(nbformat.writes(notebook).replace(f"{folder}/", ""), 4)


def lean(notebook: Any) -> Any:
    """The notebook with small pictures, and without what changes at every run."""
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type != "code":
            continue
        cell.outputs = _joined(cell.outputs)
        for output in cell.outputs:
            data = output.get("data", {})
            if "text/html" in data:
                data["text/html"] = PICTURE.sub(_smaller, data["text/html"])
    notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"]}
    return notebook


def _joined(outputs: list[Any]) -> list[Any]:
    """Outputs with printed text that follows printed text put together."""
    kept: list[Any] = []
    for output in outputs:
        if output.output_type == "stream" and kept and kept[-1].get("name") == "stdout":
            kept[-1].text += output.text
        else:
            kept.append(output)
    return kept


def _smaller(match: re.Match[str]) -> str:
    """A picture of few colours, as wide as a page."""
    picture = Image.open(io.BytesIO(base64.b64decode(match[1]))).convert("RGB")
    if picture.width > WIDTH:
        picture = picture.resize((WIDTH, picture.height * WIDTH // picture.width))
    few = picture.quantize(64, dither=Image.Dither.NONE)
    file = io.BytesIO()
    few.save(file, format="PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def main() -> None:
    """Execute the notebooks that are named, or all."""
    words = [word for word in sys.argv[1:] if word != "--check"]
    names = words or sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb"))
    for name in names:
        path, begin = NOTEBOOKS / f"{name}.ipynb", time.monotonic()
        check = "--check" in sys.argv
        text = nbformat.writes(lean(execute(path, small=check))) + "\n"
        if not check:
            path.write_text(text, "utf-8")
        kilobytes = len(text) // 1000
        print(f"{name}: {time.monotonic() - begin:.0f} s, {kilobytes} kB")


if __name__ == "__main__":
    main()
