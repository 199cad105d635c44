"""What a typed program looks like; mypy reads it strictly, and it runs."""

import numpy as np
import spaceoctopus
from numpy.typing import NDArray


def rewards(n_envs: int) -> NDArray[np.float32]:
    """The mean reward of every agent over an episode at rest."""
    config = spaceoctopus.Config("tuned", task="trajectory", set=["task.episode_steps=3"])
    batch = spaceoctopus.Batch(n_envs, config, threads=2)
    batch.reset(seed=1, goals="training")
    total: NDArray[np.float32] = np.zeros(batch.n_agents, np.float32)
    while not batch.truncated[0]:
        batch.step(np.zeros((n_envs, batch.n_agents, 3), np.float32))
        total += batch.reward.mean(axis=0)
    return total / np.float32(config.episode_steps)


found = rewards(4)
assert found.shape == (8,) and np.isfinite(found).all()
robot: spaceoctopus.Robot = spaceoctopus.Robot("release")
end = spaceoctopus.simulate(np.zeros((2, robot.n_joints)), robot)["hands"]
assert end.shape == (2, robot.n_arms, 3)

guided = spaceoctopus.Config("guided", set=["task.episode_steps=6"])
batch = spaceoctopus.Batch(1, guided)
batch.reset(seed=1, goals="evaluation")
postures = spaceoctopus.Postures(guided)
for step in range(5):
    state = batch.robot_state[0]
    told: NDArray[np.float32] = postures.update(state[:3], state[3:7], state[13:37].reshape(4, 6), batch.hand_goal[0])
    # Agents see the same, to the bit.
    assert (told == batch.observation[0, ::2, 42:50]).all(), step
    batch.step(np.zeros((1, batch.n_agents, 3), np.float32))
