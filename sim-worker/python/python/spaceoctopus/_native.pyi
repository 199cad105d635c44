"""The native part. What everything means stands in the docstrings: ``help(spaceoctopus.Batch)``."""

from collections.abc import Sequence
from os import PathLike
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Batch", "Config", "Policy", "Postures", "Robot", "__version__", "simulate"]

__version__: str

_Path = str | PathLike[str]
_Floats = NDArray[np.float32]
_Doubles = NDArray[np.float64]
_Task = Literal["trajectory", "reorientation", "capture", "mixed"]

@final
class Config:
    """What a run is configured with."""

    def __new__(
        cls, config: _Path | None = None, *, preset: str | None = None, task: _Task | None = None, set: Sequence[str] = ...
    ) -> Config: ...
    @property
    def task(self) -> str:
        """Which task: ``trajectory``, ``reorientation``, ``capture`` or ``mixed``."""
    @property
    def episode_steps(self) -> int:
        """Control steps of an episode."""
    @property
    def control_period(self) -> float:
        """Duration of a control step (s)."""
    @property
    def action_scale(self) -> float:
        """Factor from a clipped action to a joint velocity command (rad/s)."""
    @property
    def robot(self) -> str:
        """The robot's name or file."""
    @property
    def seed(self) -> int:
        """Seed of every random number."""
    @staticmethod
    def from_toml(text: str) -> Config:
        """What a run's ``config.toml`` says."""
    def to_toml(self) -> str:
        """Everything, as a run's ``config.toml`` has it."""
    def __eq__(self, other: object, /) -> bool: ...

@final
class Robot:
    """A robot: a floating base with arms of two to seven joints."""

    def __new__(cls, description: _Path = ...) -> Robot: ...
    @property
    def name(self) -> str:
        """Its name."""
    @property
    def n_arms(self) -> int:
        """Arms."""
    @property
    def n_joints(self) -> int:
        """Joints, all arms."""
    @property
    def joints(self) -> list[int]:
        """Joints of each arm."""
    @property
    def arms(self) -> list[str]:
        """Names of the arms."""
    @property
    def home(self) -> _Doubles:
        """Joint angles at home (rad), [arms, J], J those of the longest arm; zeros behind the joints of a shorter one."""
    @property
    def max_rates(self) -> _Doubles:
        """Largest joint velocity commands (rad/s), [arms, J], likewise."""
    @property
    def total_mass(self) -> float:
        """Mass of everything (kg)."""
    @staticmethod
    def from_toml(text: str) -> Robot:
        """The robot that the text of a robot file describes."""
    def to_toml(self) -> str:
        """The description, as a robot file has it."""
    def to_mjcf(self, *, contacts: bool = True) -> str:
        """The robot as a MuJoCo model (XML)."""

@final
class Batch:
    """Many environments (N) that are stepped together, all agents (A) at once, in arrays that each step fills in place."""

    def __new__(
        cls,
        n_envs: int,
        config: Config | _Path | None = None,
        *,
        task: _Task | None = None,
        set: Sequence[str] = ...,
        robot: Robot | _Path | None = None,
        threads: int | None = None,
    ) -> Batch: ...
    def reset(
        self,
        seed: int | None = None,
        *,
        iteration: int | None = None,
        first: int | None = None,
        goals: Literal["training", "evaluation"] | None = None,
    ) -> None:
        """Begins other episodes, and shows them. Those of an evaluation have no other iteration than 0."""
    def step(self, actions: ArrayLike) -> None:
        """Holds actions [N, A, U] (rad/s before scaling) for a control step, and shows what it led to."""
    def close(self) -> None:
        """Gives the environments' memory back. Arrays stay as they are."""
    @property
    def closed(self) -> bool:
        """Whether it was closed."""
    @property
    def steps(self) -> int | None:
        """Control steps since the start; None if no episode goes on."""
    @property
    def n_envs(self) -> int:
        """N: environments."""
    @property
    def n_agents(self) -> int:
        """A: agents, two an arm."""
    @property
    def joints_of_agents(self) -> list[int]:
        """Joints that each agent moves: so many of its actions mean something."""
    @property
    def episode_steps(self) -> int:
        """Control steps of an episode."""
    @property
    def threads(self) -> int:
        """Threads that work in a step."""
    @property
    def action_limit(self) -> _Floats:
        """Limits of the actions (rad/s before scaling), [A, U]: what is beyond is clipped. U is 3 where arms have six joints."""
    @property
    def config(self) -> Config:
        """What it is configured with."""
    @property
    def robot(self) -> Robot:
        """The robot."""
    @property
    def observation(self) -> _Floats:
        """What agents see, [N, A, O]."""
    @property
    def state(self) -> _Floats:
        """What critics see, [N, S]."""
    @property
    def reward(self) -> _Floats:
        """Rewards of the last step, [N, A]; zero after a reset."""
    @property
    def truncated(self) -> NDArray[np.bool_]:
        """Whether the episode was over with the last step, [N]."""
    @property
    def position_error(self) -> _Floats:
        """Norm of every hand's position error, [N, arms] (m)."""
    @property
    def orientation_error(self) -> _Floats:
        """Norm of every hand's Euler-angle difference, [N, arms] (rad)."""
    @property
    def base_error(self) -> _Floats:
        """Norm of the base's Euler-angle difference, [N] (rad)."""
    @property
    def touching_pairs(self) -> _Floats:
        """Touching pairs of bodies, [N]."""
    @property
    def hand_goal(self) -> _Floats:
        """Where hands shall go, [N, arms, 6]: position (m) and Euler angles x-y-z (rad), world."""
    @property
    def base_goal(self) -> _Floats:
        """Where the base shall turn, [N, 3]: Euler angles x-y-z (rad), world."""
    @property
    def robot_state(self) -> _Floats:
        """Robots, [N, 13 + 2·joints]: base position (m), quaternion (w first), velocity (m/s, world), angular velocity (rad/s, base axes),
        joint angles (rad), joint rates (rad/s)."""

@final
class Policy:
    """A trained policy with the world that it acts in."""

    @staticmethod
    def load(path: _Path, *, robot: Robot | _Path | None = None) -> Policy:
        """The policy of a checkpoint: its directory, a run, RUN:best, RUN:ITERATION, RUN:NAME or RUN:TAG."""
    def act(self, observation: ArrayLike) -> _Floats:
        """Mean actions for observations [N, A, O], as [N, A, U], or for [A, O], as [A, U] (rad/s before clipping and scaling)."""
    def evaluate(self, episodes: int = 30, steps: int = 200, *, seed: int = 0) -> dict[str, Any]:
        """Plays held-out episodes as ``octopus eval`` does; the figures are those of its ``--json``."""
    def play(
        self,
        episode: int = 0,
        steps: int = 200,
        *,
        seed: int = 0,
        hand_goal: ArrayLike | None = None,
        base_goal: ArrayLike | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Plays one held-out episode; returns arrays by name, a row a control step. Goals are those that the policy moves to."""
    @property
    def path(self) -> Any:
        """Directory of the checkpoint."""
    @property
    def iteration(self) -> int:
        """Iterations that it was trained on."""
    @property
    def env_steps(self) -> int:
        """Env-steps that it was trained on."""
    @property
    def config(self) -> Config:
        """What it was trained with."""
    @property
    def robot(self) -> Robot:
        """The robot."""
    @property
    def task(self) -> str:
        """The task that it learned."""
    @property
    def n_agents(self) -> int:
        """A: agents, two an arm."""

@final
class Postures:
    """Goal postures of one robot: joint angles that bring its hands to their goals."""

    def __new__(
        cls, config: Config | _Path | None = None, *, set: Sequence[str] = ..., robot: Robot | _Path | None = None
    ) -> Postures: ...
    def update(
        self, base_position: ArrayLike, base_attitude: ArrayLike, joint_angles: ArrayLike, goals: ArrayLike
    ) -> _Floats:
        """Looks once a control step; returns [arms, 2 + J]: good, free, what is left to each joint (rad), J those of the longest arm."""
    def forget(self) -> None:
        """Forgets all goals, because another episode begins."""

def simulate(
    actions: ArrayLike,
    robot: Robot | _Path | None = None,
    *,
    precision: Literal["f32", "f64"] = "f32",
    integrator: Literal["rk3", "rk4", "euler"] = "rk3",
    substep: float = 0.016,
    control_period: float = 0.4,
    contacts: bool = True,
) -> dict[str, NDArray[Any]]:
    """Simulates a robot from home under joint velocity commands [T, joints] (rad/s); returns arrays by name, a row a control step."""
