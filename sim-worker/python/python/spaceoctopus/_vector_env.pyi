from collections.abc import Sequence
from os import PathLike
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from spaceoctopus._native import Batch, Config, Robot

_Path = str | PathLike[str]
_Floats = NDArray[np.float32]
_Flags = NDArray[np.bool_]

class VectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Many environments (N) for Gymnasium, one agent commanding all joints (J): observations [N, …], actions [N, J], rewards [N]."""

    autoreset_mode: AutoresetMode
    def __init__(
        self,
        num_envs: int = 1,
        config: Config | _Path | None = None,
        *,
        task: Literal["trajectory", "reorientation", "capture", "mixed"] | None = None,
        set: Sequence[str] = (),
        robot: Robot | _Path | None = None,
        threads: int | None = None,
        observe: Literal["agents", "state"] = "agents",
        autoreset_mode: AutoresetMode = ...,
        copy: bool = True,
    ) -> None: ...
    @property
    def batch(self) -> Batch:
        """The batch below, whose arrays show the robots' states, goals and errors."""
    def reset(self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None) -> tuple[_Floats, dict[str, Any]]:
        """Begins episodes; returns observations [N, …] and infos."""
    def step(self, actions: ArrayLike) -> tuple[_Floats, NDArray[np.float64], _Flags, _Flags, dict[str, Any]]:
        """Holds actions [N, J] for a control step; returns observations, rewards [N], terminations [N], truncations [N] and infos."""
    def close_extras(self, **kwargs: Any) -> None:
        """Gives the environments' memory back."""
