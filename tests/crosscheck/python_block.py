"""Steps a batch with the actions of a worker's block, and compares bits: DIR QUESTION."""

import json
import sys
from pathlib import Path

import numpy as np
import spaceoctopus

folder, question = Path(sys.argv[1]), json.loads(sys.argv[2])
block = np.fromfile(folder / "block", np.float32)
agents, steps, envs = question["agents"], question["steps"], question["envs"]


def part(name, *shape):
    start = question["at"][name]
    return block[start : start + int(np.prod(shape))].reshape(shape)


observation = part("observation", agents, steps + 1, envs, question["observation"])
state = part("state", steps + 1, envs, question["state"])
action = part("action", agents, steps, envs, 3)
reward = part("reward", agents, steps, envs)
truncated = part("truncated", steps, envs)


def same(found, expected, what):
    # As bits: zeros have a sign, and a NaN is no excuse.
    found, expected = np.ascontiguousarray(found), np.ascontiguousarray(expected)
    assert found.shape == expected.shape and (found.view(np.uint32) == expected.view(np.uint32)).all(), what


for threads in (1, 2, 5):
    batch = spaceoctopus.Batch(envs, folder / "config.toml", threads=threads)
    shown = batch.observation
    batch.reset(question["seed"], iteration=question["iteration"], first=question["first"])
    assert not batch.truncated.any()
    for step in range(steps + 1):
        same(batch.observation.transpose(1, 0, 2), observation[:, step], "observation %d" % step)
        same(batch.state, state[step], "state %d" % step)
        if step == steps:
            break
        batch.step(np.ascontiguousarray(action[:, step].transpose(1, 0, 2)))
        same(batch.reward.T, reward[:, step], "reward %d" % step)
        assert (batch.truncated == (truncated[step] != 0)).all()
    assert batch.truncated.all() and batch.steps == steps
    assert batch.observation is shown, "arrays stay the same objects"
    # The next episodes are those of the next iteration, and go back to these.
    batch.reset()
    assert not np.array_equal(batch.observation.transpose(1, 0, 2), observation[:, 0])
    batch.reset(question["seed"], iteration=question["iteration"])
    same(batch.observation.transpose(1, 0, 2), observation[:, 0], "again")
