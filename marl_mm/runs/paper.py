"""The datasets of the paper's Tables 4 and 5 (Sec. 5.4.2)."""

from marl_mm.runs.sources import Mix, Source

GOOD_30K = Source("pretrained", steps=30_000, name="good-30k")
GOOD_60K = Source("pretrained", steps=60_000, name="good-60k", first=GOOD_30K)
PD_30K = Source("pd", steps=30_000, name="pd-30k")
_RANDOM = Source("random", steps=10_000, name="random-10k")
_MEDIUM = Source("medium", steps=5_000, name="medium-5k")

MIXES = (
    Mix(
        "mix-5k-random-5k-medium-20k-good",
        [(_RANDOM, 5_000), (_MEDIUM, 5_000), (GOOD_30K, 20_000)],
    ),
    Mix("mix-10k-random-20k-good", [(_RANDOM, 10_000), (GOOD_30K, 20_000)]),
)

PAPER = (GOOD_30K, GOOD_60K, PD_30K, _RANDOM, _MEDIUM, *MIXES)
"""All of them, those that others begin with or are drawn from first."""
