"""``python -m marl_mm``: the command ``marl-mm``."""

import sys

from marl_mm.cli import main

if __name__ == "__main__":  # processes that are spawned import this, too
    sys.exit(main(sys.argv[1:]))
