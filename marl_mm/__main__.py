"""``python -m marl_mm``: the command ``marl-mm``."""

import sys

from marl_mm.cli import main

if __name__ == "__main__":  # spawned processes import this file, too
    sys.exit(main(sys.argv[1:]))
