"""Our additions to TD3+BC; the preset ``paper`` switches all of them off.

Here: which actions are imitated (``imitate``), how their error is measured
(``imitation_weights``, ``imitation_scaled``) and a falling c (``q_weight_end``).
Elsewhere: exchanged goals (``future``, ``elsewhere``) in ``offline_batches``, bounded
targets (``clip_targets``) in ``replay.highest_target``, normalised hidden layers of the
critics (``layer_norm``) in ``networks.perceptron``.
"""

import torch

from marl_mm.algorithms.offline_batches import OfflineBatch
from marl_mm.algorithms.replay import normalized_actions
from marl_mm.algorithms.seeded import SeededCritics
from marl_mm.algorithms.td3_bc_config import WEIGHTED, Td3BcConfig
from marl_mm.datasets.arrays import EpisodeArrays
from marl_mm.errors import UsageError

LEAST_SPREAD = 0.1
"""Least standard deviation that an entry's imitation error is divided by, as a share of
half its range."""


def q_weight(config: Td3BcConfig, step: int) -> float:
    """C at an update: on a straight line to ``q_weight_end``, and then that."""
    c, end = config.q_weight, config.q_weight_end
    return c if end is None else c + (end - c) * min(1.0, step / max(1, config.updates))


class Imitation:
    """Imitation error of the actors.

    Args:
        config: Hyper-parameters.
        arrays: The dataset's episodes.
        critics: Critics that say which actions are better than the actors'.
        device: Device of batches and networks.

    Raises:
        UsageError: If a weight is of an entry that the actions do not have.
    """

    def __init__(
        self,
        config: Td3BcConfig,
        arrays: EpisodeArrays,
        critics: SeededCritics,
        device: str,
    ) -> None:
        self._imitate, self._critics = config.imitate, critics
        by_name = dict(zip(WEIGHTED, config.imitation_weights, strict=True))
        names = arrays.layout.action_names
        idle = [n for n, w in by_name.items() if w != 1 and n not in names]
        if idle:
            raise UsageError(
                f"imitation_weights has a weight for {', '.join(idle)}, expected 1: "
                f"the dataset's actions are {', '.join(names)}"
            )
        weights = torch.tensor([by_name.get(name, 1.0) for name in names])
        weights = weights / weights.mean()
        if config.imitation_scaled:
            actions = torch.from_numpy(
                normalized_actions(arrays.actions, arrays.layout)
            )
            weights /= actions.var(dim=0, correction=0).clamp_min(LEAST_SPREAD**2)
        self.weights = weights.to(device)
        """Weight of the squared error of each entry of the action, shape (k,)."""

    def error(
        self,
        action: torch.Tensor,
        state: torch.Tensor,
        batch: OfflineBatch,
        value: torch.Tensor,
        entries: slice | list[int] = slice(None),
        pair: int = 0,
    ) -> torch.Tensor:
        """Weighted mean square over the actions that are imitated, shape (S,).

        It is the mean over these, so that c weighs the same whatever their share of a
        batch. In the paper it is the mean over all.

        Args:
            action: Joint actions, the agent's own by its actor, shape (S, B, k).
            state: Normalised joint states, shape (S, B, d).
            batch: Transitions to imitate.
            value: First critic's value of ``action``, shape (S, B).
            entries: Entries that the agent sets.
            pair: Number of the agent's pair of critics.
        """
        imitated = batch.imitated
        if self._imitate == "successful":
            imitated = imitated * batch.successful
        elif self._imitate == "better":
            with torch.no_grad():
                other = action.clone()
                other[..., entries] = batch.action[..., entries]
                taken = self._critics.first(state, other, pair)
            imitated = imitated * (taken > value.detach())
        squares = (action[..., entries] - batch.action[..., entries]).square()
        errors = (squares * self.weights[entries]).mean(dim=2) * imitated
        return errors.sum(dim=1) / imitated.sum(dim=1).clamp_min(1)
