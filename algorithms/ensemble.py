"""Perceptrons that learn together: the twins of a critic, the seeds of a run.

A layer of all members is one product of matrices, and all weights stand in one flat
array, so that a step of Adam and one of a target network are one operation each.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

import torch
from torch import nn
from torch.nn import functional

from marl_mm.algorithms.networks import adam_step

State = dict[str, torch.Tensor]


class Ensemble:
    """N perceptrons of the same widths.

    Args:
        members: Perceptrons, N of them, whose weights are copied.
        device: Device of the weights.
    """

    def __init__(self, members: Sequence[nn.Sequential], device: str = "cpu") -> None:
        self._layers = list(members[0])
        first = members[0].state_dict()
        self._matrices = {name for name, value in first.items() if value.dim() == 2}
        states = [as_stored(member.state_dict()) for member in members]
        self._shapes = {
            name: (len(members), *value.shape) for name, value in states[0].items()
        }
        stacks = [torch.stack([state[name] for state in states]) for name in states[0]]
        self.flat = torch.cat([stack.flatten() for stack in stacks]).to(device)
        """Weights and biases of all members, in one flat array."""

        self.weights = self.views(self.flat)
        """Views of ``flat`` by name, for products: (N, in, out) and (N, 1, out)."""

    def __call__(
        self, inputs: torch.Tensor, chosen: slice = slice(None)
    ) -> torch.Tensor:
        """Outputs of the chosen members, shapes (N, B, d) to (N, B, k)."""
        weights = self.weights
        if chosen != slice(None):
            weights = {name: value[chosen] for name, value in weights.items()}
        values = inputs
        for number, layer in enumerate(self._layers):
            if isinstance(layer, nn.ReLU):
                values = values.relu_()  # what it overwrites nobody needs
                continue
            weight, bias = weights[f"{number}.weight"], weights[f"{number}.bias"]
            if isinstance(layer, nn.Linear):
                values = torch.baddbmm(bias, values, weight)
            else:
                values = functional.layer_norm(values, values.shape[-1:])
                values = torch.addcmul(bias, values, weight)
        return values

    def views(self, flat: torch.Tensor) -> State:
        """Parts by name of an array as long as ``flat``."""
        sizes = [torch.Size(shape).numel() for shape in self._shapes.values()]
        parts = torch.split(flat, sizes)
        named = zip(self._shapes.items(), parts, strict=True)
        return {name: part.view(shape) for (name, shape), part in named}

    def copy(self) -> "Ensemble":
        """Copy with equal weights, for a target network."""
        other = copy(self)
        other.flat = self.flat.detach().clone()
        other.weights = other.views(other.flat)
        return other

    def follow(self, other: "Ensemble", rate: float) -> None:
        """Move by a share of the way to another's weights."""
        self.flat.lerp_(other.flat, rate)

    def member(self, number: int) -> State:
        """State of one perceptron, as of ``nn.Sequential``."""
        return {
            name: value.T.contiguous() if name in self._matrices else value[0]
            for name, value in part_of(self.weights, number).items()
        }

    def load_member(self, number: int, state: Mapping[str, torch.Tensor]) -> None:
        """Load one perceptron from a state."""
        set_part(self.weights, number, as_stored(state))


class Learner:
    """Adam for all members of an ensemble at once.

    Args:
        ensemble: Networks whose weights it changes.
        rate: Learning rate.
    """

    def __init__(self, ensemble: Ensemble, rate: float) -> None:
        self._rate = rate
        self._flat = flat = ensemble.flat
        self._weights = [view.requires_grad_() for view in ensemble.weights.values()]
        self._step = torch.zeros((), device=flat.device)
        self._mean, self._square = torch.zeros_like(flat), torch.zeros_like(flat)
        self._moments = {
            "exp_avg": ensemble.views(self._mean),
            "exp_avg_sq": ensemble.views(self._square),
        }

    def descend(self, loss: torch.Tensor) -> None:
        """One gradient step; no other gradient is computed."""
        gradients = torch.autograd.grad(loss, self._weights)
        gradient = torch.cat([part.flatten() for part in gradients])
        moments = [self._mean], [self._square], [self._step]
        adam_step([self._flat], [gradient], *moments, self._rate)

    def member(self, number: int) -> dict[str, Any]:
        """State of Adam for one perceptron."""
        parts = {name: part_of(m, number) for name, m in self._moments.items()}
        return {"step": self._step.item(), **parts}

    def load_member(self, number: int, state: Mapping[str, Any]) -> None:
        """Load Adam for one perceptron from a state."""
        self._step.fill_(state["step"])
        for name, moments in self._moments.items():
            set_part(moments, number, state[name])


def as_stored(state: Mapping[str, torch.Tensor]) -> State:
    """State of one perceptron in the ensemble's shapes: (in, out) and (1, out)."""
    return {
        name: value.T if value.dim() == 2 else value[None]
        for name, value in state.items()
    }


def part_of(stacked: Mapping[str, torch.Tensor], number: int) -> State:
    """Part of one member of stacked tensors, copied to the CPU."""
    return {name: v.detach()[number].cpu().clone() for name, v in stacked.items()}


@torch.no_grad()
def set_part(
    stacked: Mapping[str, torch.Tensor], number: int, state: Mapping[str, torch.Tensor]
) -> None:
    """Write the part of one member into stacked tensors."""
    for name, values in stacked.items():
        values[number] = state[name]
