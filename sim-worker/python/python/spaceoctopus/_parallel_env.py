"""One environment for PettingZoo."""

import gymnasium
import numpy as np
import pettingzoo

from spaceoctopus._native import Batch


class ParallelEnv(pettingzoo.ParallelEnv):
    """One environment, agents by name: ``plus_y_shoulder``, ``plus_y_wrist``, and so on for each arm.

    Observations are float32 of shape [O], as the configuration says (62 numbers in preset ``guided``, 48 in ``tuned``). Actions are float32, one a
    joint of the agent (three where arms have six joints): joint velocities before scaling, clipped at the joints' limits. Nothing ends an episode before its last step; it is truncated there.

    ``config`` is the name of a preset, the path of a TOML file, or a ``Config``; ``task`` and ``set`` are as in ``octopus train``.

    The seed of ``reset`` is that of a run: with the option ``env``, the first episode is that of environment ``env`` (0) in the run's
    iteration 0, the next reset without a seed begins iteration 1, and so on. With the option ``goals="evaluation"`` goals are those of
    ``octopus eval``; ``env=e`` is its episode e, without ``env`` the next one begins, with a seed episode 0. It has no other ``iteration``
    than 0.
    """

    metadata = {"render_modes": [], "name": "spaceoctopus_v0", "is_parallelizable": True}

    def __init__(self, config=None, *, task=None, set=(), robot=None, render_mode=None):
        if render_mode is not None:
            raise ValueError("render_mode is %r: there is none, `octopus film` draws episodes" % (render_mode,))
        self.render_mode = None
        self._batch = Batch(1, config, task=task, set=set if isinstance(set, str) else list(set), robot=robot, threads=1)
        self._names = ["%s_%s" % (arm, part) for arm in _arm_names(self._batch.robot) for part in ("shoulder", "wrist")]
        self.possible_agents = list(self._names)
        self.agents = []
        self._sizes = self._batch.joints_of_agents
        limit = [row[:size] for row, size in zip(self._batch.action_limit, self._sizes)]
        _, _, observation = self._batch.observation.shape
        seen = (observation,)
        # The same object at each call, as the interface wants it; a space has a random state of its own, so none is shared.
        self.observation_spaces = {name: gymnasium.spaces.Box(-np.inf, np.inf, seen, np.float32) for name in self._names}
        self.action_spaces = {name: gymnasium.spaces.Box(-limit[i], limit[i], dtype=np.float32) for i, name in enumerate(self._names)}
        self.state_space = gymnasium.spaces.Box(-np.inf, np.inf, self._batch.state.shape[1:], np.float32)

    @property
    def batch(self):
        """The batch of one environment below, whose arrays show the robot's state, goals and errors."""
        return self._batch

    def observation_space(self, agent):
        """The space of an agent's observations; always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent):
        """The space of an agent's actions (rad/s before scaling); always the same object."""
        return self.action_spaces[agent]

    def reset(self, seed=None, options=None):
        """Begins an episode; returns observations and infos by agent."""
        # Others' options are passed to all environments of a program, so what is not known is left alone.
        options = options or {}
        begin = {"iteration": options.get("iteration"), "first": options.get("env"), "goals": options.get("goals")}
        self._batch.reset(seed, **begin)
        self.agents = list(self._names)
        return self._observations(), {name: {} for name in self._names}

    def step(self, actions):
        """Holds the agents' actions for a control step; returns observations, rewards, terminations, truncations and infos by agent."""
        if not self.agents:
            # After the end, and in a closed environment: the batch says which.
            if actions:
                self._batch.step(self._no_actions())
            return {}, {}, {}, {}, {}
        joined = self._no_actions()
        for index, (name, size) in enumerate(zip(self._names, self._sizes)):
            if name not in actions:
                raise ValueError("actions have none for %r" % name)
            action = np.asarray(actions[name])
            if action.shape != (size,):
                raise ValueError("actions[%r] has shape %s, expected (%d,)" % (name, action.shape, size))
            if action.dtype.kind not in "fiu":
                raise TypeError("actions[%r] is of type %s, expected real numbers (float32)" % (name, action.dtype))
            joined[0, index, :size] = action
        unknown = [name for name in actions if name not in self.action_spaces]
        if unknown:
            raise ValueError("actions are for %r, who is no agent" % unknown[0])
        self._batch.step(joined)
        over = bool(self._batch.truncated[0])
        names, observations = self._names, self._observations()
        rewards = dict(zip(names, map(float, self._batch.reward[0])))
        infos = {name: self._info(index) for index, name in enumerate(names)}
        if over:
            self.agents = []
        return observations, rewards, dict.fromkeys(names, False), dict.fromkeys(names, over), infos

    def _no_actions(self):
        return np.zeros((1, *self._batch.action_limit.shape), np.float32)

    def state(self):
        """What critics see, float32 of shape [S]; every quantity once in preset ``tuned``."""
        return self._batch.state[0].copy()

    def render(self):
        """Draws nothing: ``octopus film`` does."""
        return None

    def close(self):
        """Gives the environment's memory back."""
        self._batch.close()
        self.agents = []

    def _observations(self):
        rows = self._batch.observation[0].copy()
        return {name: rows[index] for index, name in enumerate(self._names)}

    def _info(self, index):
        """Errors of the hand that the agent moves, and of the base; touching pairs of the robot."""
        arm, batch = index // 2, self._batch
        return {
            "position_error": float(batch.position_error[0, arm]),
            "orientation_error": float(batch.orientation_error[0, arm]),
            "base_error": float(batch.base_error[0]),
            "touching_pairs": int(batch.touching_pairs[0]),
        }


def _arm_names(robot):
    """Names of the arms that are good for names of agents; an agent is found by its arm's index otherwise."""
    names = [str(name) for name in robot.arms]
    if len(set(names)) == len(names) and all(name.isidentifier() for name in names):
        return names
    return ["arm%d" % (index + 1) for index in range(len(names))]
