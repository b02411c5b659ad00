"""Perceptrons that learn together are those that learn one by one."""

import copy

import pytest
import torch
from torch import nn

from marl_mm.algorithms.ensemble import Ensemble, Learner
from marl_mm.algorithms.networks import Adam, perceptron

WIDTHS = 5, 7, 6, 2


def members(count: int, layer_norm: bool = False) -> list[nn.Sequential]:
    torch.manual_seed(0)
    made = [
        nn.Sequential(*perceptron(WIDTHS, layer_norm=layer_norm)) for _ in range(count)
    ]
    for one in made if layer_norm else ():
        for layer in one:
            if isinstance(layer, nn.LayerNorm):  # by default 1 and 0, which hide much
                nn.init.normal_(layer.weight)
                nn.init.normal_(layer.bias)
    return made


def inputs(count: int) -> torch.Tensor:
    return torch.randn(count, 9, 5, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("layer_norm", [False, True])
def test_products_are_those_of_the_members(layer_norm: bool) -> None:
    alone = members(3, layer_norm)
    together = Ensemble(alone)(inputs(3))
    for number, one in enumerate(alone):
        torch.testing.assert_close(together[number], one(inputs(3)[number]))


@pytest.mark.parametrize("layer_norm", [False, True])
def test_a_learner_is_adam_for_each(layer_norm: bool) -> None:
    alone = members(3, layer_norm)
    ensemble = Ensemble(alone)
    learner = Learner(ensemble, 1e-2)
    adams = [torch.optim.Adam(one.parameters(), lr=1e-2) for one in alone]
    for _ in range(6):
        learner.descend(ensemble(inputs(3)).square().mean(dim=(1, 2)).sum())
        for number, (one, adam) in enumerate(zip(alone, adams, strict=True)):
            adam.zero_grad()
            one(inputs(3)[number]).square().mean().backward()
            adam.step()
    for number, one in enumerate(alone):
        for name, value in one.state_dict().items():
            own = ensemble.member(number)[name]
            torch.testing.assert_close(own, value, atol=1e-6, rtol=1e-5)


def test_adam_is_torchs_to_the_bit_and_goes_on_from_its_state() -> None:
    """Before the first step, too, when that state is empty."""
    for taken in (0, 3):
        one, other = members(2)
        other.load_state_dict(one.state_dict())
        theirs = torch.optim.Adam(one.parameters(), lr=1e-2, fused=True)
        ours = Adam(other.parameters(), 1e-2)
        for number in range(6):
            if number == taken:
                ours.load_state_dict(theirs.state_dict())
                other.load_state_dict(one.state_dict())
            theirs.zero_grad()
            one(inputs(1)).square().mean().backward()
            theirs.step()
            ours.descend(other(inputs(1)).square().mean())
        for name, value in one.state_dict().items():
            assert torch.equal(value, other.state_dict()[name])
        assert str(ours.state_dict()["state"]) == str(theirs.state_dict()["state"])


def test_members_come_and_go_without_touching_others() -> None:
    ensemble, alone = Ensemble(members(3, True)), members(4, True)[3]
    before = [copy.deepcopy(ensemble.member(number)) for number in range(3)]
    ensemble.load_member(1, alone.state_dict())
    for number, state in enumerate(before):
        expected = alone.state_dict() if number == 1 else state
        assert expected.keys() == ensemble.member(number).keys()
        for name, value in ensemble.member(number).items():
            assert torch.equal(value, expected[name])
    torch.testing.assert_close(ensemble(inputs(3))[1], alone(inputs(3)[1]))


def test_a_state_stays_as_it_was_when_learning_goes_on() -> None:
    """What was kept to go back to is not what goes on."""
    ensemble = Ensemble(members(2, True))
    learner = Learner(ensemble, 1e-2)

    def learn() -> None:
        learner.descend(ensemble(inputs(2)).square().sum())

    learn()
    kept = ensemble.member(1), learner.member(1)
    known = copy.deepcopy(kept)
    learn()
    for name, value in known[0].items():
        assert torch.equal(kept[0][name], value)
        assert not torch.equal(ensemble.member(1)[name], value)
    for moment in ("exp_avg", "exp_avg_sq"):
        for name, value in known[1][moment].items():
            assert torch.equal(kept[1][moment][name], value)


def test_what_a_learner_knows_comes_back() -> None:
    one, other = (Ensemble(members(2)) for _ in range(2))
    learners = Learner(one, 1e-2), Learner(other, 1e-2)
    for _ in range(3):
        learners[0].descend(one(inputs(2)).square().sum())
    for number in range(2):
        other.load_member(number, one.member(number))
        learners[1].load_member(number, learners[0].member(number))
    for ensemble, learner in zip((one, other), learners, strict=True):
        learner.descend(ensemble(inputs(2)).square().sum())
    assert torch.equal(one.flat, other.flat)
    assert learners[1].member(0)["step"] == 4


def test_a_copy_follows_a_share_of_the_way() -> None:
    ensemble = Ensemble(members(2))
    target = ensemble.copy()
    start = target.flat.clone()
    Learner(ensemble, 0.1).descend(ensemble(inputs(2)).square().sum())
    assert torch.equal(target.flat, start)
    target.follow(ensemble, 0.25)
    torch.testing.assert_close(target.flat, 0.75 * start + 0.25 * ensemble.flat)
    shared = target.weights["0.weight"].data_ptr() == target.flat.data_ptr()
    assert shared, "products see what has followed"


@pytest.mark.parametrize("chosen", [slice(1, 2), slice(0, None, 2), slice(None)])
def test_chosen_members_alone_are_multiplied(chosen: slice) -> None:
    ensemble = Ensemble(members(4))
    every = ensemble(inputs(4))
    torch.testing.assert_close(ensemble(inputs(4)[chosen], chosen), every[chosen])
