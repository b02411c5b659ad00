"""marl-mm submit: runs as a folder that anybody can score again."""

from pathlib import Path

import tyro

from marl_mm.commands.options import CORES
from marl_mm.commands.output import show
from marl_mm.commands.parser import command
from marl_mm.progress import progress_bars
from marl_mm.runs.submit import submit


@command
def main(
    runs: tyro.conf.Positional[tuple[Path, ...]],
    *,
    out: Path,
    episodes: int = 200,
    seed: int = 0,
    workers: int = CORES,
    overwrite: bool = False,
    json: bool = False,
) -> None:
    """Write a submission: weights, record, rows and hashes, no code and no dataset.

    The runs' last checkpoints are evaluated once more, to have a hash of each episode.
    "marl-mm verify" scores the folder again, "marl-mm board" shows it beside others.

    Args:
        runs: Finished run folders, the seeds of one setting.
        out: Folder of the submission.
        episodes: Number of goals.
        seed: Seed of the goals.
        workers: Processes; the result does not depend on their number.
        overwrite: Replace an older submission.
        json: Print the manifest as JSON.
    """
    with progress_bars() as bar:
        made = submit(
            runs,
            out=out,
            episodes=episodes,
            seed=seed,
            workers=workers,
            overwrite=overwrite,
            progress=bar,
        )
    text = f"{out}: {made.in_words()}\nfingerprint {made.fingerprint}"
    show(dict(made.manifest), text, json)
