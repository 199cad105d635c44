#!/usr/bin/env python3
"""Measures MAPPO as the field writes it: eager PyTorch in f32 on a CPU.

Every agent has an actor, a critic and an Adam optimiser for each; Python loops over agents, epochs and mini-batches; autograd
differentiates. The algorithm is that of Yu, Velu, Vinitsky, Gao, Wang, Bayen and Wu, "The surprising effectiveness of PPO in
cooperative multi-agent games", NeurIPS 2022, with separate networks, value normalisation and the clipped Huber value loss; the
clipped surrogate is equation 7 of Schulman, Wolski, Dhariwal, Radford and Klimov, "Proximal policy optimization algorithms", 2017.
Observations and rewards are random numbers, so no simulator takes part.

Reads one JSON object from standard input, for example

    {"n_agents": 8, "observation": 28, "state": 224, "actions": 3, "hidden": [512, 512], "layer_norm": true, "activation": "relu",
     "epochs": 5, "mini_batches": 1, "n_steps": 50, "n_envs": 128, "threads": 2, "seconds": 10}

and prints one:

    env_steps_per_s            env-steps trained on per second of updates; an update takes n_steps * n_envs, in each of which all
                               agents act; it starts with returns and advantages from the values that were predicted while acting
    updates                    how many updates were measured
    inference_env_steps_per_s  env-steps per second of acting: all actors' actions and all critics' values for n_envs environments
                               at once, without gradients
    torch                      version

Times are wall times: the threads share the work. Exit status: 0 done, 2 wrong usage, 3 a package is missing.
"""

import argparse
import json
import os
import sys
import time
from dataclasses import dataclass, fields

os.environ["CUDA_VISIBLE_DEVICES"] = ""  # .venv-benches has no CUDA libraries

try:
    import torch
    from torch import nn
    from torch.distributions import Distribution, Normal
except ImportError as error:
    print(f"torch_learner: {error}: run `make venv-benches` and use .venv-benches/bin/python", file=sys.stderr)
    sys.exit(3)

GAMMA, GAE_LAMBDA = 0.99, 0.95
CLIP, VALUE_CLIP, HUBER_DELTA = 0.2, 0.2, 10.0
ENTROPY_COEFFICIENT = 0.05
LEARNING_RATE, ADAM_EPSILON, MAX_GRAD_NORM = 8e-4, 1e-5, 10.0
VALUE_NORM_BETA = 0.99999
ACTIVATIONS = {"relu": nn.ReLU, "elu": nn.ELU, "tanh": nn.Tanh}


@dataclass
class Workload:
    """What is measured, as standard input gives it."""

    n_agents: int
    observation: int
    state: int
    actions: int
    hidden: list[int]
    layer_norm: bool
    activation: str
    epochs: int
    mini_batches: int
    n_steps: int
    n_envs: int
    threads: int
    seconds: float

    @classmethod
    def from_json(cls, text):
        try:
            given = json.loads(text)
        except ValueError as error:
            raise ValueError(f"standard input is not JSON: {error}") from error
        names = [field.name for field in fields(cls)]
        if not isinstance(given, dict):
            raise ValueError("expected a JSON object")
        for name in sorted(given.keys() ^ set(names)):
            raise ValueError(f"{'unknown' if name in given else 'missing'} key {name}")
        workload = cls(**given)
        for name in set(names) - {"hidden", "layer_norm", "activation", "seconds"}:
            value = given[name]
            if type(value) is not int or value < 1:
                raise ValueError(f"{name} is {value!r}, expected a whole number from 1")
        if not isinstance(workload.hidden, list) or not all(type(width) is int and width > 0 for width in workload.hidden):
            raise ValueError(f"hidden is {workload.hidden!r}, expected a list of widths")
        if type(workload.layer_norm) is not bool:
            raise ValueError(f"layer_norm is {workload.layer_norm!r}, expected true or false")
        if workload.activation not in ACTIVATIONS:
            raise ValueError(f"activation is {workload.activation!r}, expected one of {', '.join(ACTIVATIONS)}")
        if type(workload.seconds) not in (int, float) or not 0 < workload.seconds < float("inf"):
            raise ValueError(f"seconds is {workload.seconds!r}, expected a positive number")
        if workload.mini_batches > workload.samples:
            raise ValueError(f"mini_batches is {workload.mini_batches}, there are {workload.samples} samples")
        return workload

    @property
    def samples(self):
        return self.n_steps * self.n_envs


def linear(inputs, outputs, gain):
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def mlp(inputs, outputs, head_gain, workload):
    """LayerNorm on the input, then after each activation; a linear head."""
    gain = nn.init.calculate_gain("relu" if workload.activation == "elu" else workload.activation)
    layers = [nn.LayerNorm(inputs)] if workload.layer_norm else []
    for width in workload.hidden:
        layers += [linear(inputs, width, gain), ACTIVATIONS[workload.activation]()]
        if workload.layer_norm:
            layers.append(nn.LayerNorm(width))
        inputs = width
    return nn.Sequential(*layers, linear(inputs, outputs, head_gain))


class Actor(nn.Module):
    def __init__(self, workload):
        super().__init__()
        self.mean = mlp(workload.observation, workload.actions, 0.01, workload)
        self.log_std = nn.Parameter(torch.zeros(workload.actions))

    def forward(self, observation):
        return Normal(self.mean(observation).tanh(), self.log_std.exp())


class ValueNorm:
    """Running moments of the returns; critics predict in their units."""

    def __init__(self):
        self.mean = self.mean_square = self.debias = torch.zeros(())

    def update(self, returns):
        self.mean = torch.lerp(returns.mean(), self.mean, VALUE_NORM_BETA)
        self.mean_square = torch.lerp(returns.square().mean(), self.mean_square, VALUE_NORM_BETA)
        self.debias = torch.lerp(torch.ones(()), self.debias, VALUE_NORM_BETA)

    def moments(self):
        debias = self.debias.clamp(min=1e-5)
        mean = self.mean / debias
        return mean, (self.mean_square / debias - mean.square()).clamp(min=1e-2).sqrt()

    def normalise(self, x):
        mean, std = self.moments()
        return (x - mean) / std

    def denormalise(self, x):
        mean, std = self.moments()
        return x * std + mean


class Agent:
    """One agent's networks, optimisers and rollout."""

    def __init__(self, workload):
        self.workload = workload
        self.actor, self.critic = Actor(workload), mlp(workload.state, 1, 1.0, workload)
        self.actor_optimizer, self.critic_optimizer = (
            torch.optim.Adam(network.parameters(), lr=LEARNING_RATE, eps=ADAM_EPSILON) for network in (self.actor, self.critic)
        )
        self.value_norm = ValueNorm()
        shape = (workload.n_steps, workload.n_envs)
        self.observation = torch.empty(*shape, workload.observation)
        self.action = torch.empty(*shape, workload.actions)
        self.log_prob, self.reward = torch.empty(shape), torch.empty(shape)
        self.value = torch.empty(workload.n_steps + 1, workload.n_envs)

    @torch.no_grad()
    def act(self, step, state):
        policy = self.actor(self.observation[step])
        action = policy.sample()
        self.action[step] = action
        self.log_prob[step] = policy.log_prob(action).sum(-1)
        self.value[step] = self.critic(state).squeeze(-1)

    @torch.no_grad()
    def returns(self, last_state):
        """Returns by generalised advantage estimation; episodes end by their time limit after the last step."""
        self.value[-1] = self.critic(last_state).squeeze(-1)
        value = self.value_norm.denormalise(self.value)
        advantage = torch.zeros(self.workload.n_envs)
        returns = torch.empty_like(self.reward)
        for step in reversed(range(self.workload.n_steps)):
            delta = self.reward[step] + GAMMA * value[step + 1] - value[step]
            advantage = delta + GAMMA * GAE_LAMBDA * advantage
            returns[step] = advantage + value[step]
        return returns, returns - value[:-1]

    def update(self, state, epochs):
        returns, advantage = self.returns(state[-1])
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-5)
        samples = [self.observation, state[:-1], self.action, self.log_prob, advantage, self.value[:-1], returns]
        samples = [x.flatten(0, 1) for x in samples]
        for _ in range(epochs):
            for rows in torch.randperm(self.workload.samples).chunk(self.workload.mini_batches):
                self.step(*(x[rows] for x in samples))

    def step(self, observation, state, action, old_log_prob, advantage, old_value, returns):
        """One step of each optimiser on a mini-batch."""
        policy = self.actor(observation)
        ratio = (policy.log_prob(action).sum(-1) - old_log_prob).exp()
        surrogate = torch.min(ratio * advantage, ratio.clamp(1 - CLIP, 1 + CLIP) * advantage)
        entropy = policy.entropy().sum(-1)
        descend(-surrogate.mean() - ENTROPY_COEFFICIENT * entropy.mean(), self.actor, self.actor_optimizer)

        self.value_norm.update(returns)
        target = self.value_norm.normalise(returns)
        value = self.critic(state).squeeze(-1)
        clipped = old_value + (value - old_value).clamp(-VALUE_CLIP, VALUE_CLIP)
        huber = nn.HuberLoss(reduction="none", delta=HUBER_DELTA)
        descend(torch.max(huber(value, target), huber(clipped, target)).mean(), self.critic, self.critic_optimizer)


def descend(loss, network, optimizer):
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), MAX_GRAD_NORM)
    optimizer.step()


def collect(agents, state):
    """One rollout on fresh random observations and rewards; returns how long acting took (s)."""
    state.normal_()
    for agent in agents:
        agent.observation.normal_()
        agent.reward.normal_()
    start = time.perf_counter()
    for step in range(len(state) - 1):
        for agent in agents:
            agent.act(step, state[step])
    return time.perf_counter() - start


def update(agents, state, epochs):
    """One update of all agents; returns how long it took (s)."""
    start = time.perf_counter()
    for agent in agents:
        agent.update(state, epochs)
    return time.perf_counter() - start


def measure(workload):
    torch.manual_seed(1)
    torch.set_num_threads(workload.threads)
    Distribution.set_default_validate_args(False)
    agents = [Agent(workload) for _ in range(workload.n_agents)]
    state = torch.empty(workload.n_steps + 1, workload.n_envs, workload.state)

    collect(agents, state)
    update(agents, state, epochs=1)
    updates, acting, updating = 0, 0.0, 0.0
    while acting + updating < workload.seconds:
        acting += collect(agents, state)
        updating += update(agents, state, workload.epochs)
        updates += 1
    return {
        "env_steps_per_s": updates * workload.samples / updating,
        "updates": updates,
        "inference_env_steps_per_s": updates * workload.samples / acting,
        "torch": torch.__version__,
    }


def main():
    parser = argparse.ArgumentParser(prog="torch_learner", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.error = lambda message: parser.exit(2, f"{parser.prog}: {message}\n")
    parser.parse_args()
    try:
        workload = Workload.from_json(sys.stdin.read())
    except ValueError as error:
        parser.exit(2, f"{parser.prog}: {error}\n")
    print(json.dumps(measure(workload)))


if __name__ == "__main__":
    main()
