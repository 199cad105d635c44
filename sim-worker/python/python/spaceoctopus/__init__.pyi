from spaceoctopus._native import Batch as Batch
from spaceoctopus._native import Config as Config
from spaceoctopus._native import Policy as Policy
from spaceoctopus._native import Postures as Postures
from spaceoctopus._native import Robot as Robot
from spaceoctopus._native import __version__ as __version__
from spaceoctopus._native import simulate as simulate
from spaceoctopus._parallel_env import ParallelEnv as ParallelEnv
from spaceoctopus._vector_env import VectorEnv as VectorEnv

__all__ = ["Batch", "Config", "ParallelEnv", "Policy", "Postures", "Robot", "VectorEnv", "__version__", "simulate"]
