from collections.abc import Sequence
from os import PathLike
from typing import Any, Literal

import gymnasium
import numpy as np
import pettingzoo  # type: ignore[import-untyped]
from numpy.typing import NDArray

from spaceoctopus._native import Batch, Config, Robot

_Path = str | PathLike[str]
_Floats = NDArray[np.float32]

class ParallelEnv(pettingzoo.ParallelEnv):  # type: ignore[misc]
    """One environment for PettingZoo, agents by name: observations [O] and actions, one a joint of the agent (rad/s before scaling), in float32."""

    metadata: dict[str, Any]
    render_mode: None
    agents: list[str]
    possible_agents: list[str]
    observation_spaces: dict[str, gymnasium.spaces.Box]
    action_spaces: dict[str, gymnasium.spaces.Box]
    state_space: gymnasium.spaces.Box
    def __init__(
        self,
        config: Config | _Path | None = None,
        *,
        task: Literal["trajectory", "reorientation", "capture", "mixed"] | None = None,
        set: Sequence[str] = (),
        robot: Robot | _Path | None = None,
        render_mode: None = None,
    ) -> None: ...
    @property
    def batch(self) -> Batch:
        """The batch of one environment below, whose arrays show the robot's state, goals and errors."""
    def observation_space(self, agent: str) -> gymnasium.spaces.Box:
        """The space of an agent's observations; always the same object."""
    def action_space(self, agent: str) -> gymnasium.spaces.Box:
        """The space of an agent's actions (rad/s before scaling); always the same object."""
    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, _Floats], dict[str, dict[str, Any]]]:
        """Begins an episode; returns observations and infos by agent."""
    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, _Floats], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Holds the agents' actions for a control step; returns observations, rewards, terminations, truncations and infos by agent."""
    def state(self) -> _Floats:
        """What critics see, [S]."""
    def render(self) -> None:
        """Draws nothing: ``octopus film`` does."""
    def close(self) -> None:
        """Gives the environment's memory back."""
