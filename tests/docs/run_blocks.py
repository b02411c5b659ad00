"""Runs a page's code blocks in the folder one is in: ``python run_blocks.py PAGE``.

Without a page it reads lines of a page and a folder, and runs each in a process of its
own, in which everything is imported; after each it prints the exit status.

A ``python`` block is run, or, if it has a title, saved as that file; the ``marl-mm``
lines of a ``bash`` block are commands. Blocks of other languages are only shown. The
numbers that say how long something takes are made small; everything else is as written.
"""

import gc
import os
import re
import shutil
import sys
import traceback
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

LIBRARIES = (
    *("torch", "matplotlib.figure", "matplotlib.backends.backend_agg", "numba"),
    *("scipy.stats", "gymnasium", "minari", "h5py", "pinocchio", "pettingzoo"),
    *("mujoco", "rich.table", "tyro", "tensorboard.summary.writer.event_file_writer"),
)
"""What takes seconds to import."""

BLOCK = re.compile(r"^```(python|bash)(?: title=\"(.*?)\")?\n(.*?)^```$", re.M | re.S)

SMALL = {
    "steps": "20",
    "episodes": "2",
    "updates": "60",
    "max_steps": "2",
}
"""How long things take in place of what a page says."""

FEW = {
    "collect": "--workers 1",
    "train": "--updates 60 --curve-episodes 1 --eval-episodes 2 --max-steps 2 "
    "--workers 1",
    "eval": "--max-steps 2 --workers 1",
    "play": "--max-steps 2 --fps 1 --camera.width 96 --camera.height 64",
    "ablate": "--workers 1",
    "bench": "--turns 1 --steps 1 --vector 2 --workers 1",
    "submit": "--episodes 2 --workers 1",
    "verify": "--workers 1",
}
"""Options that commands get beside those of a page."""


_GOALS = r",\s*(eval_episodes|curve_episodes|max_steps|workers)=\d+"


def _with_few(call: re.Match[str]) -> str:
    """A call of ``train`` that evaluates hardly anything."""
    asked = re.sub(_GOALS, "", call[1]).rstrip().rstrip(",")
    return f"{asked}, eval_episodes=2, curve_episodes=1, max_steps=2, workers=1)"


def small_code(code: str) -> str:
    """Python with small numbers."""
    for name, value in SMALL.items():
        code = re.sub(rf"\b{name}=[\d_]+", f"{name}={value}", code)
    code = re.sub(r'("[a-z]+": \d+)00\b', r"\1", code)  # steps of a mix
    code = re.sub(r"  #.*", "", code)
    code = re.sub(r"\.learn\(200\)", ".learn(110)", code)  # it waits for 100
    code = re.sub(r"(marl_mm\.train\((?:[^()]|\([^()]*\))*)\)", _with_few, code)
    evaluations = r"evaluate|robustness|cross_play"
    evaluated = rf"(marl_mm\.(?:{evaluations})\((?:[^()]|\([^()]*\))*)\)"
    code = re.sub(evaluated, r"\1, max_steps=2)", code)
    return re.sub(r"(marl_mm\.play\([^)]*)\)", r"\1, max_steps=2, fps=1)", code)


def small_command(line: str) -> list[str]:
    """Words of a command with small numbers."""
    for name, value in SMALL.items():
        line = re.sub(rf"--{name.replace('_', '-')} \d+", f"--{name} {value}", line)
    line = re.sub(r":(\d+)00\b", r":\1", line)  # steps of a mix
    words = line.replace('"', "").split()[1:]
    return [*words, *FEW.get(words[0], "").split()]


def run(page: Path) -> None:
    """Run a page's blocks in order; names of one are there in the next."""
    from marl_mm.cli import main  # in the page's own process

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


def serve() -> None:
    """Run the pages of standard input, each in a fork that has imported all."""
    for name in LIBRARIES:
        import_module(name)
    with TemporaryDirectory() as shipped:
        os.environ["MINARI_DATASETS_PATH"] = shipped
        package = import_module("marl_mm")
        from marl_mm.sim.config import ENGINES, is_installed

        package.load_dataset("good-5k")  # unpacked once, then copied
        few = {"episodes": 1, "max_steps": 1, "workers": 1}
        for engine in filter(is_installed, ENGINES):  # what this takes is imported
            package.evaluate("random", engine=engine, **few)
        import_module("marl_mm.runs.train")
        import_module("marl_mm.eval.studies")
        gc.freeze()
        return serve_pages(Path(shipped))


def serve_pages(shipped: Path) -> None:
    """Run the pages of standard input, with what lies in a folder of datasets."""
    for line in sys.stdin:
        page, folder = line.rstrip("\n").split("\t")
        if not (child := os.fork()):
            os.chdir(folder)
            shutil.copytree(shipped, "datasets")
            os.environ["MINARI_DATASETS_PATH"] = str(Path(folder, "datasets"))
            said = os.open("said.txt", os.O_WRONLY | os.O_CREAT)
            os.dup2(said, 1)
            os.dup2(said, 2)
            sys.stdin.close()
            status = 1
            try:
                run(Path(page))
                status = 0
            except BaseException:
                traceback.print_exc()
            sys.stderr.flush()
            os._exit(status)  # what is the server's is not its own to delete
        _, status = os.waitpid(child, 0)
        sys.stdout.write(f"{status}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    run(Path(sys.argv[1])) if sys.argv[1:] else serve()
