"""A trained policy in NumPy, to be taken elsewhere.

    from actor import Actor
    actor = Actor("deploy/policies/trajectory")
    rates = actor.commands(observations)

What the observations are stands in `sim-worker/ENVIRONMENT.md`. Needs Python 3.11, numpy, safetensors.
"""

import pathlib
import tomllib

import numpy as np
import safetensors.numpy

ACTIVATIONS = {
    "relu": lambda x: np.maximum(x, 0.0),
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
    "tanh": np.tanh,
}


def layer_norm(x, gain, shift):
    """LayerNorm over the last axis (Ba, Kiros and Hinton 2016)."""
    deviation = x - x.mean(-1, keepdims=True)
    return deviation / np.sqrt((deviation**2).mean(-1, keepdims=True) + 1e-5) * gain + shift


class Actor:
    """The actors of a checkpoint, a directory with policy.safetensors, config.toml and robot.toml.

    There are A agents, two an arm: the shoulder (joints 1 to 3), then the wrist (4 to 6). Each sees O
    numbers and moves three joints.
    """

    def __init__(self, checkpoint):
        checkpoint = pathlib.Path(checkpoint)
        self.parameters = safetensors.numpy.load_file(checkpoint / "policy.safetensors")
        self.config = tomllib.loads((checkpoint / "config.toml").read_text())
        robot = tomllib.loads((checkpoint / "robot.toml").read_text())
        rates = [link["servo"]["max_rate"] for link in robot["links"]]
        self.limits = np.tile(rates, len(robot["arms"]))

    def means(self, observations):
        """Actions without noise (A, ..., 3) for observations (A, ..., O)."""
        network, algorithm = self.config["network"], self.config["algorithm"]
        head = self.parameters["head.weight"]
        # One actor an agent; with `ppo` one for all, which sees their observations one after the other.
        actors, agents = len(head), len(observations)
        x = observations.reshape(actors, agents // actors, *observations.shape[1:])
        x = np.moveaxis(x, 1, -2)
        x = x.reshape(*x.shape[:-2], -1)

        def vector(name):
            values = self.parameters[name]
            return values.reshape(actors, *[1] * (x.ndim - 2), -1)

        if network["input_norm"] == "running":
            x = (x - vector("input.mean")) * vector("input.inverse_std")
            x = np.clip(x, -network["input_clip"], network["input_clip"])
        elif network["input_norm"] == "layer_norm":
            x = layer_norm(x, vector("input.gain"), vector("input.bias"))
        for layer in range(len(network["hidden"])):
            name = f"hidden.{layer}."
            x = np.einsum("a...i,aio->a...o", x, self.parameters[name + "weight"])
            x = ACTIVATIONS[network["activation"]](x + vector(name + "bias"))
            if network["layer_norm"]:
                x = layer_norm(x, vector(name + "gain"), vector(name + "shift"))
        x = np.einsum("a...i,aio->a...o", x, head) + vector("head.bias")
        if network["squash_mean"]:
            limit = algorithm["maddpg"]["action_limit"] if algorithm["name"] == "maddpg" else 1.0
            x = limit * np.tanh(x)
        x = x.reshape(*x.shape[:-1], agents // actors, 3)
        return np.moveaxis(x, -2, 1).reshape(agents, *observations.shape[1:-1], 3)

    def commands(self, observations):
        """Joint velocities (rad/s), arm after arm, to hold for a control period; observations (A, O)."""
        actions = self.means(observations).reshape(-1)
        return self.config["task"]["action_scale"] * np.clip(actions, -self.limits, self.limits)
