"""A trained policy in NumPy, to be taken elsewhere.

    from actor import Actor
    actor = Actor("deploy/policies/trajectory")
    action = actor.actions(observations)   # what the next observations say of this step
    rates = actor.scale * action           # the same as actor.commands(observations)

What the observations are stands in `deploy/guide/src/environment.md`. Needs Python 3.11 or newer:

    pip install numpy safetensors
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

    There are A agents, two an arm: the shoulder (the first half of the joints), then the wrist. Each sees O
    numbers and has U actions, one for each of its joints: three where arms have six. Observations are arrays or nested lists of shape (A, O), or (A, ..., O)
    for many robots at once.
    """

    def __init__(self, checkpoint):
        checkpoint = pathlib.Path(checkpoint)
        self.parameters = safetensors.numpy.load_file(checkpoint / "policy.safetensors")
        self.config = tomllib.loads((checkpoint / "config.toml").read_text())
        robot = tomllib.loads((checkpoint / "robot.toml").read_text())
        of_arm = lambda arm: robot["arm_types"][arm["type"]]["links"] if "type" in arm else robot["links"]
        rates = [[link["servo"]["max_rate"] for link in of_arm(arm)] for arm in robot["arms"]]
        self.limits = np.concatenate(rates)
        # Agents have as many actions as the one with most joints, and postures room for the longest arm: which of them are there.
        joints = np.array([len(arm) for arm in rates])
        self.n_actions = (joints.max() + 1) // 2
        of_agents = np.stack([(joints + 1) // 2, joints // 2], 1).reshape(-1)
        self.agent_moves = np.arange(self.n_actions) < of_agents[:, None]
        self.arm_has = np.arange(joints.max()) < joints[:, None]
        self.scale = self.config["task"]["action_scale"]
        # One actor an agent; with `ppo` one for all, which sees their observations one after the other.
        self.n_agents = 2 * len(robot["arms"])
        first = self.parameters["hidden.0.weight"]
        self.n_observation = first.shape[1] * len(first) // self.n_agents

    def check(self, observations):
        """Observations as an array (A, ..., O) of finite numbers; says what is wrong with others."""
        wanted = f"({self.n_agents}, {self.n_observation}), or ({self.n_agents}, ..., {self.n_observation}) for many robots"
        try:
            x = np.asarray(observations)
            # Integers, too, and what is not a number is refused; float32 stays what it is.
            x = x if np.issubdtype(x.dtype, np.floating) else x.astype(np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(f"observations are no array of numbers; wanted is the shape {wanted}") from error
        if x.ndim < 2 or x.shape[0] != self.n_agents or x.shape[-1] != self.n_observation:
            raise ValueError(f"observations have the shape {x.shape}; wanted is {wanted}")
        wrong = np.argwhere(~np.isfinite(x))
        if len(wrong):
            at = tuple(int(i) for i in wrong[0])
            more = f" ({len(wrong)} such numbers)" if len(wrong) > 1 else ""
            raise ValueError(f"observation {at[-1]} of agent {at[0]} is {x[at]}, at {at}{more}; wanted are finite numbers")
        return x

    def means(self, observations):
        """What the networks say, before it is clipped: (A, ..., U) for observations (A, ..., O)."""
        observations = self.check(observations)
        network, algorithm = self.config["network"], self.config["algorithm"]
        head = self.parameters["head.weight"]
        actors, agents = len(head), self.n_agents
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
        x = x.reshape(*x.shape[:-1], agents // actors, self.n_actions)
        return np.moveaxis(x, -2, 1).reshape(agents, *observations.shape[1:-1], self.n_actions)

    def actions(self, observations):
        """Clipped actions, joint after joint: (..., J) for observations (A, ..., O).

        These, not the commands, are the last action that the next observations hold.
        """
        return self.acted(observations, np.moveaxis(self.means(observations), 0, -2)[..., self.agent_moves])

    def acted(self, observations, said):
        """What joints do where agents say so much, joint after joint: goal postures are gone to beside, then all is clipped."""
        posture = self.config["task"].get("posture", {"gain": 0.0})
        if posture["gain"] > 0.0:
            share, there = self.guidance(observations, posture["gain"], posture.get("fade", 0.0))
            said = share * said + there
        return np.clip(said, -self.limits, self.limits)

    def guidance(self, observations, gain, fade):
        """Where there are goal postures, which observations tell: the share of what the networks say, and the actions that go there, (..., J) each."""
        # Of the shoulders' observations: whether the posture is free of stops, and what is left to it (rad).
        room = self.arm_has.shape[1]
        seen = np.moveaxis(self.check(observations)[::2], 0, -2)[..., -3 * room - 2 : -2 * room]
        free, left = seen[..., 1:2], seen[..., 2:]
        there = gain / (self.config["env"]["control_period"] * self.scale) * free * left
        limits = np.full(self.arm_has.shape, np.inf)
        limits[self.arm_has] = self.limits
        there = there / np.maximum((np.abs(there) / limits).max(-1, keepdims=True), 1.0)
        share = np.ones_like(there)
        if fade > 0.0:
            # Near the posture what the networks say counts less.
            share *= np.minimum(np.abs(left).max(-1, keepdims=True) / fade, 1.0)
        return share[..., self.arm_has], there[..., self.arm_has]

    def commands(self, observations):
        """Joint velocities (rad/s), joint after joint, to hold for a control period: (..., 3 A)."""
        return self.scale * self.actions(observations)
