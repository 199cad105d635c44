"""Checks what `deploy/policies/actor.py` makes of lists, batches and wrong observations: actor_inputs.py REPOSITORY."""

import pathlib
import sys

import numpy as np

policies = pathlib.Path(sys.argv[1]) / "deploy" / "policies"
sys.path.insert(0, str(policies))
from actor import Actor  # noqa: E402

actor = Actor(policies / "trajectory")
random = np.random.default_rng(1)
batch = random.normal(size=(8, 5, 2, 62))
one = batch[:, 3, 1]

commands = actor.commands(one)
assert commands.shape == (24,) and np.abs(commands).max() > 0.01, commands
assert np.array_equal(actor.commands(one.tolist()), commands), "lists"
assert np.allclose(actor.commands(batch)[3, 1], commands, atol=1e-12), "a batch"
assert actor.commands(batch).shape == (5, 2, 24), actor.commands(batch).shape
assert np.allclose(actor.commands(np.zeros((8, 62), int)), actor.commands(np.zeros((8, 62))))
assert np.allclose(actor.actions(one) * 0.8, commands), "commands are scaled actions"
assert Actor(policies / "reorientation").commands(np.zeros((8, 39))).shape == (24,)


def refusal(observations):
    """What is said of observations that are wrong."""
    try:
        actor.commands(observations)
    except ValueError as error:
        return str(error)
    raise AssertionError("taken")


broken = one.copy()
broken[5, 7] = np.nan
assert "observation 7 of agent 5 is nan" in refusal(broken), refusal(broken)
broken[6, 0] = np.inf
assert "2 such numbers" in refusal(broken), refusal(broken)
assert "observation 7 of agent 5" in refusal(broken.tolist())
for wrong in [one[:7], one[:, :61], one[0], one.T, 3.0]:
    assert "wanted is (8, 62)" in refusal(wrong), refusal(wrong)
assert "no array of numbers" in refusal([[1.0, 2.0], [3.0]])
assert "no array of numbers" in refusal([["a"] * 62] * 8)
print("fine")
