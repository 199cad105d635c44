"""Checks `deploy/policies/actor.py` against a block of a run: actor.py CHECKPOINT BLOCK.

A worker records the logarithm of the probability density of every action that it drew. The same density by the
means that NumPy computes from the recorded observations says whether they are the means that the worker acted on.
Prints the largest difference, in standard deviations of an action (deterministic actors: rad/s).
"""

import pathlib
import sys

import numpy as np
import safetensors.numpy

sys.path.insert(0, str(pathlib.Path(__file__).parents[2] / "deploy" / "policies"))
from actor import Actor  # noqa: E402

actor = Actor(sys.argv[1])
block = safetensors.numpy.load_file(sys.argv[2])
observation, action = block["observation"][:, :-1], block["action"]
mean = actor.means(observation.astype(np.float64))
if "log_std" in actor.parameters:
    log_std = actor.parameters["log_std"].reshape(len(action), 1, 1, 3).astype(np.float64)
    z = (action - mean) * np.exp(-log_std)
    log_prob = (-0.5 * z**2 - log_std - 0.5 * np.log(2.0 * np.pi)).sum(-1)
    # d log p = z dz, so that this is a difference of the means where an action is a deviation or more away.
    error = np.abs(log_prob - block["log_prob"]) / np.maximum(1.0, np.linalg.norm(z, axis=-1))
else:
    # Deterministic actors, of a run without noise: the actions are the means.
    error = np.abs(action - mean)
commands = actor.commands(observation[:, 0, 0])
limits = actor.limits * actor.scale
assert commands.shape == limits.shape and np.isfinite(commands).all(), commands
assert (np.abs(commands) <= limits * (1 + 1e-12)).all(), commands
posture = actor.config["task"].get("posture", {"gain": 0.0})
if posture["gain"] > 0.0:
    # What the next observations call the last action is the sum, clipped: shoulder and wrist of an arm see all six.
    drawn = np.moveaxis(action[:, :-1], 0, -2).reshape(*action[:, :-1].shape[1:3], -1)
    told = np.moveaxis(block["observation"][::2, 1:-1, :, -6:], 0, -2).reshape(drawn.shape)
    summed = actor.acted(observation[:, :-1], drawn)
    assert np.abs(told - summed).max() < 1e-4, np.abs(told - summed).max()
    share, there = actor.guidance(observation, posture["gain"], posture["fade"])
    assert np.abs(there).mean() > 0.05, "nothing is added"
    assert (share.min() < 0.5) == (posture["fade"] > 0.0), "what agents say counts as much everywhere"
# Many robots at once are commanded as each alone.
together = actor.commands(observation[:, 0])
assert together.shape == (observation.shape[2], len(limits)), together.shape
assert np.abs(together[0] - commands).max() < 1e-4, "robots side by side"
assert error.size > 100 and np.abs(mean).mean() > 0.1, "nothing to compare"
print(error.max())
