"""Runs a page's code blocks in the folder one is in: ``python run_blocks.py PAGE``.

A ``python`` block is run, or, if it has a title, saved as that file; the ``marl-mm``
lines of a ``bash`` block are commands. Blocks of other languages are only shown. The
numbers that say how long something takes are made small; everything else is as written.
"""

import re
import sys
from pathlib import Path

from marl_mm.cli import main

BLOCK = re.compile(r"^```(python|bash)(?: title=\"(.*?)\")?\n(.*?)^```$", re.M | re.S)

SMALL = {
    "steps": "60",
    "episodes": "2",
    "updates": "60",
    "max_steps": "2",
}
"""How long things take in place of what a page says."""

FEW = {
    "collect": "--workers 1",
    "train": "--updates 60 --curve-episodes 1 --eval-episodes 2 --max-steps 4 "
    "--workers 1",
    "eval": "--max-steps 4 --workers 1",
    "play": "--max-steps 2 --fps 2",
    "ablate": "--workers 1",
}
"""Options that commands get beside those of a page."""


def small_code(code: str) -> str:
    """Python with small numbers."""
    for name, value in SMALL.items():
        code = re.sub(rf"\b{name}=[\d_]+", f"{name}={value}", code)
    code = re.sub(
        r"(marl_mm\.train\(.*?)\)$",
        r"\1, eval_episodes=2, curve_episodes=1, max_steps=4, workers=1)",
        re.sub(r"  #.*", "", code),
        flags=re.M,
    )
    evaluated = r"(marl_mm\.(?:evaluate|robustness|cross_play)\([^)]*)\)"
    code = re.sub(evaluated, r"\1, max_steps=4)", code)
    return re.sub(r"(marl_mm\.play\([^)]*)\)", r"\1, max_steps=2, fps=2)", code)


def small_command(line: str) -> list[str]:
    """Words of a command with small numbers."""
    for name, value in SMALL.items():
        line = re.sub(rf"--{name.replace('_', '-')} \d+", f"--{name} {value}", line)
    line = re.sub(r":(\d+)00\b", r":\1", line)  # steps of a mix
    words = line.replace('"', "").split()[1:]
    return [*words, *FEW.get(words[0], "").split()]


def run(page: Path) -> None:
    """Run a page's blocks in order; names of one are there in the next."""
    names: dict[str, object] = {"__name__": "page"}
    for language, title, text in BLOCK.findall(page.read_text()):
        if title:
            Path(title).write_text(text)
        elif language == "python":
            exec(compile(small_code(text), page.name, "exec"), names)
        else:
            for line in text.splitlines():
                if line.startswith("marl-mm") and main(small_command(line)):
                    sys.exit(f"{page}: {line}")


if __name__ == "__main__":
    run(Path(sys.argv[1]))
