"""The space robot's simulator in Python.

A robot floats without gravity: a base with four arms of six joints (or the arms that its description has). Each arm is two
agents, ``shoulder`` (the first half of the joints, cares for the hand's position) and ``wrist`` (the others, cares for its orientation).

* :class:`Batch`: thousands of environments at once, in NumPy arrays that each step fills in place.
* :class:`ParallelEnv`: one environment for PettingZoo, agents by name. Needs the package ``pettingzoo``.
* :class:`VectorEnv`: many environments for Gymnasium, one agent commanding everything. Needs the package ``gymnasium``.
* :class:`Policy`: a trained policy; it acts, and plays episodes as ``octopus eval`` does.
* :class:`Postures`: the goal postures that policies see which were trained with them, for who runs an exported one.
* :class:`Robot`, :class:`Config`, :func:`simulate`: the robot, what a run is configured with, and commands in open loop.

The same configuration, seed and address give the same bits as in a worker of a training, whatever the number of environments or
threads. What is wrong with a value is a ``ValueError`` or ``TypeError``, what is wrong with the moment of a call a ``RuntimeError``.
"""

from spaceoctopus._native import Batch, Config, Policy, Postures, Robot, __version__, simulate

__all__ = ["Batch", "Config", "ParallelEnv", "Policy", "Postures", "Robot", "VectorEnv", "__version__", "simulate"]

# What each needs is not installed with this package.
_NEEDS = {"ParallelEnv": ("_parallel_env", "pettingzoo"), "VectorEnv": ("_vector_env", "gymnasium")}


def __getattr__(name):
    if name not in _NEEDS:
        raise AttributeError("module %r has no attribute %r" % (__name__, name))
    import importlib

    module, extra = _NEEDS[name]
    try:
        found = getattr(importlib.import_module("spaceoctopus." + module), name)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.startswith("spaceoctopus"):
            raise
        message = "spaceoctopus.%s needs the package %s: pip install 'spaceoctopus[%s]'" % (name, error.name, extra)
        raise ModuleNotFoundError(message, name=error.name) from error
    globals()[name] = found
    return found


def __dir__():
    return sorted(set(globals()) | set(__all__))
