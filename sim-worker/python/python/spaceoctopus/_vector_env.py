"""Many environments for Gymnasium."""

import operator

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from spaceoctopus._native import Batch


class VectorEnv(gymnasium.vector.VectorEnv):
    """Many environments in which one agent commands everything.

    Observations are float32 of shape [N, A·O], those of all agents one after the other, or, with ``observe="state"``, of shape [N, S], what
    critics see. Actions are float32 of shape [N, J]: joint velocities before scaling, arm-major, clipped at the joints' limits. The reward
    is the mean over the agents'.

    Episodes begin and end together and are truncated at their last step. ``autoreset_mode`` says what follows:

    * ``NEXT_STEP``: the step after the last one begins the next episodes; its actions are ignored and its rewards zero.
    * ``SAME_STEP``: the last step returns the next episodes' first observations; the last ones are in ``info["final_obs"]``.
    * ``DISABLED``: nothing; call ``reset``.

    ``config``, ``task``, ``set``, ``robot`` and ``threads`` are as for ``Batch``. The seed of ``reset`` is that of a run, whose iterations
    are the episodes; environment n is environment n of the run. Options: ``iteration``, ``env`` (index of the first environment) and
    ``goals`` ("training" or "evaluation": then environment n plays episode ``env`` + n of ``octopus eval``, and the next N episodes follow;
    it has no other ``iteration`` than 0).
    """

    def __init__(
        self,
        num_envs=1,
        config=None,
        *,
        task=None,
        set=(),
        robot=None,
        threads=None,
        observe="agents",
        autoreset_mode=AutoresetMode.NEXT_STEP,
        copy=True,
    ):
        if observe not in ("agents", "state"):
            raise ValueError('observe is %r, expected "agents" or "state"' % (observe,))
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self._batch = Batch(num_envs, config, task=task, set=set if isinstance(set, str) else list(set), robot=robot, threads=threads)
        if observe == "state" and self._batch.state.shape[1] == 0:
            self._batch.close()
            raise ValueError('observe is "state", but critics see what agents see (network.critic_state = "own")')
        self.num_envs = num_envs
        self.render_mode = None
        self._copy = copy
        # Views: a step fills them.
        shown = self._batch.observation.reshape(num_envs, -1) if observe == "agents" else self._batch.state
        self._shown = shown
        # Where agents have different numbers of joints, not all of the batch's actions move one.
        limit = self._batch.action_limit
        sizes = np.asarray(self._batch.joints_of_agents)
        self._moves = np.arange(limit.shape[1]) < sizes[:, None]
        limit = limit[self._moves]
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, shown.shape[1:], np.float32)
        self.single_action_space = gymnasium.spaces.Box(-limit, limit, dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    @property
    def batch(self):
        """The batch below, whose arrays show the robots' states, goals and errors."""
        return self._batch

    def reset(self, *, seed=None, options=None):
        """Begins episodes; returns observations [N, …] and infos."""
        if isinstance(seed, (list, tuple, np.ndarray)):
            raise ValueError("seed is a list: one seed is the run's, and environments are told apart by their index")
        # Gymnasium takes Python's own integers alone, and only after the episodes have begun.
        seed = None if seed is None else operator.index(seed)
        options = dict(options or {})
        begin = {"iteration": options.pop("iteration", None), "first": options.pop("env", None), "goals": options.pop("goals", None)}
        mask = options.pop("reset_mask", None)
        if options:
            raise ValueError("options %s are not known: env, iteration and goals are" % ", ".join(map(repr, options)))
        if mask is not None and not np.all(mask):
            raise ValueError("reset_mask leaves environments out, but episodes begin and end together")
        self._batch.reset(seed, **begin)
        super().reset(seed=seed)
        return self._observations(), {}

    def step(self, actions):
        """Holds actions [N, J] for a control step; returns observations, rewards [N], terminations [N], truncations [N] and infos."""
        batch, n = self._batch, self.num_envs
        if self.autoreset_mode == AutoresetMode.NEXT_STEP and not batch.closed and batch.truncated[0]:
            batch.reset()
            return self._observations(), np.zeros(n), np.zeros(n, np.bool_), np.zeros(n, np.bool_), {}
        actions = np.asarray(actions)
        if actions.shape != self.action_space.shape:
            raise ValueError("actions has shape %s, expected %s" % (actions.shape, self.action_space.shape))
        by_agent = np.zeros((n, *self._moves.shape), actions.dtype)
        by_agent[:, self._moves] = actions
        batch.step(by_agent)
        rewards = batch.reward.mean(axis=1, dtype=np.float64)
        truncated = batch.truncated.copy()
        infos = self._infos()
        if truncated[0] and self.autoreset_mode == AutoresetMode.SAME_STEP:
            final = self._shown.copy()
            present = np.ones(n, np.bool_)
            infos = {"final_obs": _objects(final), "_final_obs": present, "final_info": infos, "_final_info": present}
            batch.reset()
        return self._observations(), rewards, np.zeros(n, np.bool_), truncated, infos

    def close_extras(self, **kwargs):
        """Gives the environments' memory back."""
        self._batch.close()

    def _observations(self):
        return self._shown.copy() if self._copy else self._shown

    def _infos(self):
        """Errors and contacts, an array each, with the masks that the interface has beside them."""
        batch, infos = self._batch, {}
        for name in ("position_error", "orientation_error", "base_error", "touching_pairs"):
            infos[name] = getattr(batch, name).copy()
            infos["_" + name] = np.ones(self.num_envs, np.bool_)
        return infos


def _objects(rows):
    """An array of arrays, as Gymnasium's own environments return final observations."""
    objects = np.empty(len(rows), dtype=object)
    for index, row in enumerate(rows):
        objects[index] = row
    return objects
