"""PettingZoo's and Gymnasium's own checkers, and what they do not look at."""

import warnings
from pathlib import Path

import gymnasium
import numpy as np
import spaceoctopus
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode
from pettingzoo.test import parallel_api_test, parallel_seed_test

SHORT = ["task.episode_steps=7"]
# Advice that does not apply: observations have no bounds that would mean something.
warnings.filterwarnings("ignore", message=".*(infinity|symmetric|normalized).*")

# --- PettingZoo -------------------------------------------------------------------------------------------------
for config, task in (("tuned", "trajectory"), ("release", "trajectory"), ("paper", "reorientation")):
    env = spaceoctopus.ParallelEnv(config, task=task, set=SHORT)
    parallel_api_test(env, num_cycles=30)
    env.close()
parallel_seed_test(lambda: spaceoctopus.ParallelEnv(set=SHORT))

env = spaceoctopus.ParallelEnv(set=SHORT)
assert env.possible_agents[:3] == ["plus_y_shoulder", "plus_y_wrist", "minus_y_shoulder"] and len(env.possible_agents) == 8
for agent in env.possible_agents:
    assert env.observation_space(agent) is env.observation_space(agent)
    assert env.action_space(agent) is env.action_space(agent)
first, _ = env.reset(seed=3)
assert env.state().shape == env.state_space.shape == (237,)
again, _ = env.reset(seed=3)
other, _ = env.reset()
assert data_equivalence(first, again) and not data_equivalence(first, other)
kept = other["plus_y_wrist"].copy()
for step in range(7):
    assert env.agents == env.possible_agents
    seen, rewards, ends, cuts, infos = env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    assert not any(ends.values()) and all(cuts.values()) == (step == 6) and set(infos) == set(env.possible_agents)
assert env.agents == [] and env.step({}) == ({}, {}, {}, {}, {})
assert np.array_equal(kept, other["plus_y_wrist"]), "what was returned is the caller's"

# The same environment as in a batch.
batch = spaceoctopus.Batch(3, set=SHORT)
batch.reset(5, first=40)
seen, _ = env.reset(seed=5, options={"env": 42})
assert np.array_equal(np.stack([seen[agent] for agent in env.agents]), batch.observation[2])

# Arms of six, six, seven and seven joints: an agent has an action for each of its joints.
SEVEN = Path(__file__).parents[2] / "sim-worker" / "simulator" / "robots" / "seven-joints.toml"
env = spaceoctopus.ParallelEnv(set=SHORT, robot=SEVEN)
parallel_api_test(env, num_cycles=30)
sizes = [env.action_space(agent).shape[0] for agent in env.possible_agents]
assert sizes == [3, 3, 3, 3, 4, 3, 4, 3] == env.batch.joints_of_agents
batch = spaceoctopus.Batch(2, set=SHORT, robot=SEVEN)
assert batch.action_limit.shape == (8, 4) and (batch.action_limit[:4, 3] == 0).all() and (batch.action_limit[4, :] > 0).all()
assert batch.robot.joints == [6, 6, 7, 7] and batch.robot.home.shape == (4, 7) and (batch.robot.home[:2, 6] == 0).all()
several = spaceoctopus.VectorEnv(2, set=SHORT, robot=SEVEN)
assert several.single_action_space.shape == (26,)
batch.reset(5)
seen, _ = env.reset(seed=5, options={"env": 1})
several.reset(seed=5)
actions = np.random.default_rng(3).uniform(-1, 1, (2, 26)).astype(np.float32)
several.step(actions)
starts = np.cumsum([0, *sizes])
by_agent = {agent: actions[1, starts[i] : starts[i + 1]] for i, agent in enumerate(env.possible_agents)}
seen = env.step(by_agent)[0]
padded = np.zeros((2, 8, 4), np.float32)
for i, (agent, size) in enumerate(zip(env.possible_agents, sizes)):
    padded[:, i, :size] = actions[:, starts[i] : starts[i + 1]]
    # What there is no joint for moves nothing.
    padded[:, i, size:] = 7.0
batch.step(padded)
assert np.array_equal(np.stack([seen[agent] for agent in env.possible_agents]), batch.observation[1])
assert np.array_equal(several.batch.observation, batch.observation)
env.close()
several.close()

# --- Gymnasium --------------------------------------------------------------------------------------------------
for observe, size in (("agents", 8 * 62), ("state", 237)):
    envs = spaceoctopus.VectorEnv(3, set=SHORT, observe=observe)
    assert envs.single_observation_space.shape == (size,) and envs.observation_space.shape == (3, size)
    assert envs.single_action_space.shape == (24,)
    envs.close()


def episode(envs, steps, **reset):
    rows = [envs.reset(**reset)]
    envs.action_space.seed(7)
    rows += [envs.step(envs.action_space.sample()) for _ in range(steps)]
    return rows


for mode in AutoresetMode:
    make = lambda: spaceoctopus.VectorEnv(5, set=SHORT, autoreset_mode=mode)  # noqa: B023, E731
    envs, twin = make(), make()
    assert envs.metadata["autoreset_mode"] is mode
    rows = episode(envs, 7, seed=11)
    assert data_equivalence(rows, episode(twin, 7, seed=11)), "a seed says everything"
    for seen, *rest in rows:
        assert envs.observation_space.contains(seen)
    seen, rewards, ends, cuts, infos = rows[-1]
    assert cuts.all() and not ends.any() and rewards.shape == (5,) and cuts.dtype == ends.dtype == np.bool_
    assert not any(row[3].any() for row in rows[1:-1])
    begin, _ = twin.reset(seed=11, options={"iteration": 1})
    if mode is AutoresetMode.NEXT_STEP:
        assert not np.array_equal(seen, begin)
        seen, rewards, ends, cuts, infos = envs.step(envs.action_space.sample())
        assert np.array_equal(seen, begin) and not rewards.any() and not cuts.any()
    elif mode is AutoresetMode.SAME_STEP:
        assert np.array_equal(seen, begin)
        final = np.stack(infos["final_obs"])
        plain = spaceoctopus.VectorEnv(5, set=SHORT, autoreset_mode=AutoresetMode.DISABLED)
        assert np.array_equal(final, episode(plain, 7, seed=11)[-1][0]), "the last observations are kept"
        assert infos["_final_obs"].all() and infos["final_info"]["position_error"].shape == (5, 4)
    else:
        try:
            envs.step(envs.action_space.sample())
        except RuntimeError as error:
            assert "reset first" in str(error), error
        else:
            raise AssertionError("an episode that is over cannot be stepped")
        seen, _ = envs.reset()
        assert np.array_equal(seen, begin)
    envs.close()


class Single(gymnasium.Env):
    """One environment of a vector, so that Gymnasium's checker for single ones can look at it."""

    def __init__(self):
        self.envs = spaceoctopus.VectorEnv(1, set=SHORT, autoreset_mode=AutoresetMode.DISABLED)
        self.observation_space = self.envs.single_observation_space
        self.action_space = self.envs.single_action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        seen, _ = self.envs.reset(seed=seed, options=options)
        return seen[0], {}

    def step(self, action):
        seen, rewards, ends, cuts, _ = self.envs.step(action[None])
        return seen[0], float(rewards[0]), bool(ends[0]), bool(cuts[0]), {}


from gymnasium.utils.env_checker import check_env  # noqa: E402

check_env(Single(), skip_render_check=True, skip_close_check=True)

# Gymnasium's own wrappers for vectors run on it.
envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(spaceoctopus.VectorEnv(4, set=SHORT))
envs.reset(seed=1)
for _ in range(7):
    *_, infos = envs.step(envs.action_space.sample())
assert infos["episode"]["l"].tolist() == [7] * 4, infos
