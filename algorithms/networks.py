"""Networks that carry their own input statistics: no checkpoint can lose them."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from torch import nn
from torch.optim.adam import adam

from marl_mm.layout import AgentLayout


class Normalizer(nn.Module):
    """Shifts and scales observations by statistics kept as buffers.

    Args:
        mean: Means of the observations, shape (d,).
        std: Standard deviations of the observations, shape (d,).
    """

    mean: torch.Tensor
    std: torch.Tensor

    def __init__(self, mean: torch.Tensor, std: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("mean", mean.clone())
        self.register_buffer("std", std.clone())

    @classmethod
    def blank(cls, width: int) -> "Normalizer":
        """Identity, for observations of shape (..., width)."""
        return cls(torch.zeros(width), torch.ones(width))

    @classmethod
    def of(cls, data: torch.Tensor, floor: float) -> "Normalizer":
        """Statistics of a dataset.

        Args:
            data: Observations, shape (n, d).
            floor: Least standard deviation, so that entries which hardly vary in the
                data, as the base's y, are not blown up.
        """
        return cls(data.mean(dim=0), data.std(dim=0, correction=0).clamp_min(floor))

    def set(self, mean: torch.Tensor, std: torch.Tensor) -> None:
        """Replace the statistics in place."""
        self.mean.copy_(mean)
        self.std.copy_(std)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Normalised observations, shapes (..., d) to (..., d)."""
        return (observation - self.mean) / self.std


@dataclass(frozen=True)
class Form:
    """Form of a policy's networks."""

    noisy: bool = False
    """Whether they take standard normal noise as wide as their outputs."""

    flow_steps: int = 0
    """Euler steps of a flow from noise to action; 0: the network gives the action."""

    chunk: int = 1
    """Actions in a row that they give at once."""

    def widths(self, agent: AgentLayout, hidden: Sequence[int]) -> tuple[int, ...]:
        """Units of the layers of an agent's network, from inputs to outputs."""
        outputs = self.chunk * len(agent.action)
        noise = outputs * self.noisy
        inputs = len(agent.observation) + noise + (self.flow_steps > 0)
        return inputs, *hidden, outputs

    def act(
        self,
        network: Callable[[torch.Tensor], torch.Tensor],
        observed: torch.Tensor,
        noise: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """Actions in [-1, 1] of a network, shape (..., h k): h of them in a row.

        A flow's network is a velocity at an action and a time, from noise at 0 to the
        action at 1 (Lipman 2023).

        Args:
            network: The network.
            observed: Normalised observations, shape (..., d).
            noise: Standard normal noise, shape (..., h k), if the form is noisy.
        """
        if noise is None:
            return torch.tanh(network(observed))
        if not self.flow_steps:
            return torch.tanh(network(torch.cat([observed, noise], dim=-1)))
        action = noise
        for step in range(self.flow_steps):
            time = torch.full_like(action[..., :1], step / self.flow_steps)
            velocity = network(torch.cat([observed, action, time], dim=-1))
            action = action + velocity / self.flow_steps
        return action.clamp(-1, 1)


PLAIN = Form()
"""An action without noise."""


class Actor(nn.Module):
    """Policy of one agent, in normalised action coordinates.

    Args:
        normalizer: Normalizer of its observations, shape (..., d).
        widths: Units of the layers, from inputs to outputs.
        form: Form of the network.
    """

    def __init__(
        self, normalizer: Normalizer, widths: Sequence[int], form: Form = PLAIN
    ) -> None:
        super().__init__()
        self.normalizer, self.form = normalizer, form
        self.noise = widths[-1] * form.noisy
        """Number of entries of noise that it takes."""

        self.layers = nn.Sequential(*perceptron(widths))
        if form.noisy:
            steps = torch.tensor(form.flow_steps)
            self.register_buffer("flow_steps", steps)  # for its state

    def forward(
        self, observation: torch.Tensor, noise: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Actions in [-1, 1], shapes (..., d) and (..., h k) to (..., h k)."""
        return self.form.act(self.layers, self.normalizer(observation), noise)


class Critic(nn.Module):
    """Value of a joint action at a joint state.

    Args:
        normalizer: Normalizer of the states, shape (..., d).
        actions: Number of action entries k, in [-1, 1].
        hidden: Units of the hidden layers.
        layer_norm: Whether hidden layers are normalised, which bounds the values of
            actions outside of the data (Ball 2023).
    """

    def __init__(
        self,
        normalizer: Normalizer,
        actions: int,
        hidden: Sequence[int],
        *,
        layer_norm: bool,
    ) -> None:
        super().__init__()
        self.normalizer = normalizer
        width = normalizer.mean.shape[0] + actions
        widths = [width, *hidden, 1]
        self.layers = nn.Sequential(*perceptron(widths, layer_norm=layer_norm))

    def forward(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Values, shapes (..., d) and (..., k) to (...)."""
        inputs = torch.cat([self.normalizer(state), action], dim=-1)
        value: torch.Tensor = self.layers(inputs).squeeze(-1)
        return value


def perceptron(widths: Sequence[int], *, layer_norm: bool = False) -> list[nn.Module]:
    """Linear layers of these widths; hidden ones with ReLU, and LayerNorm before it."""
    layers: list[nn.Module] = []
    for width, following in pairwise(widths[:-1]):
        layers.append(nn.Linear(width, following))
        if layer_norm:
            layers.append(nn.LayerNorm(following))
        layers.append(nn.ReLU())
    return [*layers, nn.Linear(widths[-2], widths[-1])]


class ActionScale:
    """Map from [-1, 1] coordinates to an action space.

    Args:
        low: Lowest actions, shape (k,).
        high: Highest actions, shape (k,).
    """

    def __init__(self, low: torch.Tensor, high: torch.Tensor) -> None:
        self._low, self._high = low, high
        self._range = high - low

    def denormalize(self, action: torch.Tensor) -> torch.Tensor:
        """Actions of the action space for actions in [-1, 1], also if rounded."""
        scaled = self._low + (action + 1) / 2 * self._range
        return scaled.clamp(self._low, self._high)


class Adam:
    """Adam of some parameters, with the state of ``torch.optim.Adam``.

    It has less overhead per step than that one, and saves a second of import.

    Args:
        parameters: Parameters of networks, changed in place.
        rate: Learning rate.
    """

    def __init__(self, parameters: Iterable[nn.Parameter], rate: float) -> None:
        self._parameters, self._rate = [*parameters], rate
        self._means, self._squares = (
            [torch.zeros_like(p) for p in self._parameters] for _ in range(2)
        )
        self._steps = [torch.zeros(()) for _ in self._parameters]

    @torch.no_grad()
    def descend(self, loss: torch.Tensor) -> None:
        """One gradient step; other networks' gradients stay as they are."""
        gradients = torch.autograd.grad(loss, self._parameters)
        moments = self._means, self._squares, self._steps
        adam_step(self._parameters, list(gradients), *moments, self._rate)

    def state_dict(self) -> dict[str, Any]:
        """Moments and number of steps by the parameter's number."""
        return {"state": dict(enumerate(self._states()))}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Load a state; before a first step that of ``torch.optim.Adam`` is empty."""
        for number, own in enumerate(self._states()):
            for name, values in own.items():
                given = state["state"][number][name] if state["state"] else 0.0
                values.copy_(torch.as_tensor(given))

    def _states(self) -> Iterator[dict[str, torch.Tensor]]:
        """The arrays themselves, by name."""
        arrays = zip(self._steps, self._means, self._squares, strict=True)
        for step, mean, square in arrays:
            yield {"step": step, "exp_avg": mean, "exp_avg_sq": square}


def adam_step(
    weights: list[Any],
    gradients: list[torch.Tensor],
    means: list[torch.Tensor],
    squares: list[torch.Tensor],
    steps: list[torch.Tensor],
    rate: float,
) -> None:
    """One fused step of Adam on arrays in place; arguments are lists of as many."""
    adam(
        weights,
        gradients,
        means,
        squares,
        [],
        steps,
        fused=True,
        amsgrad=False,
        beta1=0.9,
        beta2=0.999,
        lr=rate,
        weight_decay=0.0,
        eps=1e-8,
        maximize=False,
    )
