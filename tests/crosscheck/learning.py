"""Checks an update of the learner against an implementation in JAX and Optax.

Usage: learning.py DIRECTORY, with in it

  config.toml           the run's configuration
  before.safetensors    the training state before the update
  after.safetensors     the training state after it
  record.safetensors    the samples, the rows of every mini-batch, and what the learner computed on
                        its way: values, advantages, returns, unclipped gradients, losses

Nothing here follows the learner's code: networks are written as their definition says, gradients
are jax.grad's, the optimiser is optax.adam behind optax.clip_by_global_norm, a shared network is
one tree of parameters. Prints the largest errors; exits with 1 if one exceeds its tolerance.

Tolerances. The learner sums in f32 (rounding 6e-8) over up to about 100 samples and 30 inputs, in
another order than XLA: 2e-5 of a tensor's largest entry covers two layers of it. Later steps start
from parameters that have drifted apart: Adam divides by the root of the second moment, so an entry
whose gradient is a thousandth of the largest moves with a relative error of 2e-2. Hence
2e-2 * learning rate * steps for the largest error of a parameter, and a twentieth of it for the mean.
"""

import sys
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
from safetensors.numpy import load_file

GRADIENT = 2e-5
DRIFTED = 2e-3
failures = []


def compare(name, ours, theirs, tolerance, scale=None):
    ours, theirs = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    assert ours.shape == theirs.shape, f"{name}: {ours.shape} {theirs.shape}"
    scale = max(np.abs(theirs).max(), 1e-12) if scale is None else scale
    error = np.abs(ours - theirs).max() / scale
    if not error <= tolerance:
        failures.append(f"{name}: error {error:.3e}, tolerance {tolerance:.1e}")
    return error


def network(kind, state, agents):
    """Parameters of each agent as a dictionary, from the stacked state."""
    prefix = f"{kind}."
    names = [n[len(prefix):] for n in state if n.startswith(prefix) and ".adam." not in n]
    return [{n: jnp.asarray(state[prefix + n][a]) for n in names} for a in range(agents)]


def standardise(x):
    mean = x.mean(-1, keepdims=True)
    return (x - mean) / jnp.sqrt(((x - mean) ** 2).mean(-1, keepdims=True) + 1e-5)


class Learner:
    def __init__(self, directory):
        self.config = tomllib.loads((directory / "config.toml").read_text())
        self.before = load_file(directory / "before.safetensors")
        self.after = load_file(directory / "after.safetensors")
        self.record = load_file(directory / "record.safetensors")
        self.agents = len(self.before["actor.head.bias"])
        if "reward" in self.record:
            self.agents = self.record["reward"].shape[0]
        # Fewer than agents where one has an output for each of several: agent a's is number a // C of critic a % C.
        self.critics = len(self.before["critic.head.bias"])
        self.central = self.config["algorithm"]["name"] == "ppo"
        self.activation = {"relu": jax.nn.relu, "elu": jax.nn.elu, "tanh": jnp.tanh}[
            self.config["network"]["activation"]
        ]

    def apply(self, p, x):
        """One agent's network on inputs [B, in]; p is its dictionary."""
        return self.layers(p, standardise(x) if "input.gain" in p else x)

    def layers(self, p, x):
        """Likewise, on inputs that are standardised if they have to be."""
        if "input.gain" in p:
            x = x * p["input.gain"] + p["input.bias"]
        layer = 0
        while f"hidden.{layer}.weight" in p:
            name = f"hidden.{layer}."
            x = self.activation(x @ p[name + "weight"] + p[name + "bias"])
            if name + "gain" in p:
                x = standardise(x) * p[name + "gain"] + p[name + "shift"]
            layer += 1
        return x @ p["head.weight"] + p["head.bias"]

    def normalise(self, name, x, agent):
        """Running normalisation with the moments before the update."""
        if f"{name}.mean" not in self.before:
            return x
        mean, m2 = self.before[f"{name}.mean"][agent], self.before[f"{name}.m2"][agent]
        std = np.sqrt(m2 / self.before[f"{name}.count"][0] + 1e-6)
        clip = self.config["network"]["input_clip"]
        return np.clip((x - mean) / std, -clip, clip).astype(np.float32)

    def inputs(self):
        r = self.record
        actor = [self.normalise("observation_norm", r["observation"][a], a) for a in range(self.agents)]
        if self.central:
            actor = [np.concatenate(actor, -1)]
        if self.config["network"]["critic_state"] == "own":
            return actor, actor
        state = self.normalise("state_norm", r["state"], 0)
        return actor, [state] * self.agents

    def check(self):
        algorithm, r = self.config["algorithm"], self.record
        if self.central:
            # One agent instead: it does what all do, with the product of their densities, and is paid
            # for all.
            r = {
                **r,
                "action": np.concatenate(list(r["action"]), -1)[None],
                "log_prob": r["log_prob"].sum(0, keepdims=True),
                "reward": r["reward"].sum(0, keepdims=True),
            }
        agents, steps, envs = r["reward"].shape
        actor_in, critic_in = self.inputs()
        actors = network("actor", self.before, agents)
        critics = network("critic", self.before, self.critics)

        # Values and advantages, one environment after the other.
        norm = {k: self.before[f"value_norm.{k}"].copy() for k in ("mean", "mean_square", "debias")}

        def moments():
            if not algorithm["value_norm"]:
                return np.zeros(agents), np.ones(agents)
            debias = np.maximum(norm["debias"], 1e-5)
            mean = norm["mean"] / debias
            return mean, np.sqrt(np.maximum(norm["mean_square"] / debias - mean**2, 1e-2))

        def value_of(p, a, x):
            return self.apply(p, x)[..., a // self.critics]

        value = np.stack([np.asarray(value_of(critics[a % self.critics], a, x)) for a, x in enumerate(critic_in)])
        compare("value", value, r["value"], GRADIENT)
        mean, std = moments()
        scaled = value * std[:, None, None] + mean[:, None, None]
        advantage = np.zeros((agents, steps, envs))
        for a in range(agents):
            for e in range(envs):
                following = 0.0
                for t in reversed(range(steps)):
                    over, cut = r["terminated"][t, e] > 0, r["truncated"][t, e] > 0
                    future = scaled[a, t + 1, e]
                    if over or (cut and not algorithm["bootstrap_truncated"]):
                        future = 0.0
                    delta = r["reward"][a, t, e] + algorithm["gamma"] * future - scaled[a, t, e]
                    decay = 0.0 if over or cut else algorithm["gamma"] * algorithm["gae_lambda"]
                    following = delta + decay * following
                    advantage[a, t, e] = following
        returns = advantage + scaled[:, :-1]
        compare("advantage", advantage, r["advantage"], GRADIENT)
        compare("returns", returns, r["returns"], GRADIENT)
        if algorithm["normalize_advantage"]:
            flat = advantage.reshape(agents, -1)
            flat = (flat - flat.mean(1, keepdims=True)) / (flat.std(1, ddof=1, keepdims=True) + 1e-5)
            advantage = flat.reshape(advantage.shape)

        # Samples by row: step-major, then environment.
        def rows(x):
            return jnp.asarray(np.asarray(x, np.float32).reshape(steps * envs, *x.shape[2:]))

        actor_in = jnp.stack([rows(x[:-1]) for x in actor_in])
        critic_in = jnp.stack([rows(x[:-1]) for x in critic_in])
        samples = {
            "action": jnp.stack([rows(x) for x in r["action"]]),
            "log_prob": jnp.stack([rows(x) for x in r["log_prob"]]),
            "advantage": jnp.stack([rows(x) for x in advantage]),
            "old": jnp.stack([rows(x) for x in value[:, :-1]]),
            "returns": jnp.stack([rows(x) for x in returns]),
        }

        floor = self.config["network"]["min_log_std"]

        def actor_loss(p, a, batch):
            mean = self.apply(p, actor_in[a][batch])
            if self.config["network"]["squash_mean"]:
                mean = jnp.tanh(mean)
            # A parameter that stands on the floor still moves: no half gradient, as of a maximum.
            log_std = jnp.where(p["log_std"] >= floor, p["log_std"], floor)
            z = (samples["action"][a][batch] - mean) / jnp.exp(log_std)
            log_prob = (-(z**2) / 2 - log_std - jnp.log(2 * jnp.pi) / 2).sum(-1)
            ratio = jnp.exp(log_prob - samples["log_prob"][a][batch])
            adv = samples["advantage"][a][batch]
            clip = algorithm["clip"]
            surrogate = jnp.minimum(ratio * adv, jnp.clip(ratio, 1 - clip, 1 + clip) * adv)
            if algorithm["dual_clip"] > 0:
                dual = jnp.maximum(surrogate, algorithm["dual_clip"] * adv)
                surrogate = jnp.where(adv < 0, dual, surrogate)
            policy = -algorithm["surrogate_multiplier"] * surrogate.mean()
            entropy = (log_std + 0.5 * jnp.log(2 * jnp.pi * jnp.e)).sum()
            return policy - algorithm["entropy_coefficient"] * entropy, policy

        def huber(e):
            d = algorithm["huber_delta"]
            if d == 0:
                return e**2 / 2
            return jnp.where(jnp.abs(e) <= d, e**2 / 2, d * (jnp.abs(e) - d / 2))

        def critic_loss(p, a, batch, target_mean, target_std):
            v = value_of(p, a, critic_in[a][batch])
            old = samples["old"][a][batch]
            target = (samples["returns"][a][batch] - target_mean) / target_std
            loss = huber(v - target)
            if algorithm["value_clip"] > 0:
                clipped = old + jnp.clip(v - old, -algorithm["value_clip"], algorithm["value_clip"])
                loss = jnp.maximum(loss, huber(clipped - target))
            loss = algorithm["value_coefficient"] * loss.mean()
            return loss, loss

        own = "hidden.0.bias"

        def pack(stacked, networks):
            """Trees that an optimiser each moves: one a network, with the own biases of its agents."""
            if networks == len(stacked):
                return stacked
            return [
                {**stacked[n], own: jnp.stack([p[own] for p in stacked[n::networks]])}
                for n in range(networks)
            ]

        def unpack(trees, rows):
            """The tree of each row."""
            networks = len(trees)
            if networks == rows:
                return trees
            pick = lambda a: trees[a % networks]
            return [{**pick(a), own: pick(a)[own][a // networks]} for a in range(agents)]

        def total(loss, networks, rows):
            """Per tree: loss of one agent, or the mean over a network's agents."""
            if networks == agents:
                return lambda tree, a, *rest: loss(tree, a, *[x[a] if k else x for k, x in enumerate(rest)])

            def mean_loss(tree, n, batch, *rest):
                tree_of = lambda i: {**tree, own: tree[own][i]} if rows == agents else tree
                parts = [
                    loss(tree_of(i), a, batch, *[x[a] for x in rest])
                    for i, a in enumerate(range(n, agents, networks))
                ]
                return sum(p[0] for p in parts) / len(parts), jnp.stack([p[1] for p in parts])

            return mean_loss

        optimizer = self.config["optimizer"]
        env_steps = int(self.before["counters.env_steps"][0])
        factor = 1.0
        if optimizer["schedule"] == "linear":
            factor = 1 - env_steps / self.config["run"]["env_steps"]

        class Half:
            """One kind of network with its optimiser."""

            def __init__(half, kind, loss):
                half.kind, half.rate = kind, optimizer[f"{kind}_lr"] * factor
                networks = self.networks(kind)
                half.rows = agents if kind == "actor" else self.critics
                half.trees = pack(network(kind, self.before, half.rows), networks)
                transform = optax.adam(
                    half.rate, b1=optimizer["beta1"], b2=optimizer["beta2"], eps=optimizer["epsilon"]
                )
                limit = algorithm["max_grad_norm"]
                clip = optax.clip_by_global_norm(limit) if limit > 0 else optax.identity()
                half.optimizer = optax.chain(clip, transform)
                half.gradient = jax.jit(
                    jax.value_and_grad(total(loss, networks, half.rows), has_aux=True), static_argnums=1
                )
                half.states = []
                moments = {}
                for moment in ("m", "v"):
                    of_moment = {
                        f"{kind}.{n}": self.before[f"{kind}.adam.{moment}.{n}"] for n in half.trees[0]
                    }
                    moments[moment] = pack(network(kind, of_moment, half.rows), networks)
                for i, tree in enumerate(half.trees):
                    state = half.optimizer.init(tree)
                    adam = state[1][0]._replace(
                        count=jnp.asarray(self.before[f"{kind}.adam.steps"][i], jnp.int32),
                        mu=moments["m"][i],
                        nu=moments["v"][i],
                    )
                    half.states.append((state[0], (adam, *state[1][1:])))

            def projected(half, tree):
                """With no deviation below its floor."""
                if "log_std" not in tree:
                    return tree
                return {**tree, "log_std": jnp.maximum(tree["log_std"], floor)}

            def step(half, index, batch, *rest):
                gradients, losses = [], []
                for i, tree in enumerate(half.trees):
                    (_, loss), gradient = half.gradient(tree, i, batch, *rest)
                    update, half.states[i] = half.optimizer.update(gradient, half.states[i], tree)
                    half.trees[i] = half.projected(optax.apply_updates(tree, update))
                    gradients.append(gradient)
                    losses.append(loss)
                tolerance = GRADIENT if index == 0 else DRIFTED
                # Losses of a network's agents stand together; agents of the networks take turns.
                losses = np.asarray(losses).reshape(len(half.trees), -1).T.reshape(-1)
                # Ratios of the synthetic log-probabilities make losses of several hundred.
                scale = max(1.0, float(np.abs(losses).max()))
                compare(f"{half.kind} loss {index}", losses, r[f"loss.{index}.{half.kind}"], tolerance, scale)
                for name in half.trees[0]:
                    recorded = r[f"gradient.{index}.{half.kind}.{name}"]
                    theirs = np.stack([g[name] for g in unpack(gradients, half.rows)])
                    compare(f"{half.kind} gradient {index} of {name}", recorded, theirs, tolerance)

            def finish(half, steps):
                for name in half.trees[0]:
                    theirs = np.stack([p[name] for p in unpack(half.trees, half.rows)])
                    ours = self.after[f"{half.kind}.{name}"]
                    scale = half.rate * steps
                    worst = compare(f"{half.kind} {name} after", ours, theirs, 2e-2, scale)
                    mean = np.abs(ours - theirs).mean() / scale
                    if mean > 1e-3:
                        failures.append(f"{half.kind} {name} after: mean error {mean:.3e} of a move")
                    half.worst = max(getattr(half, "worst", 0.0), worst)

        actor, critic = Half("actor", actor_loss), Half("critic", critic_loss)
        index = 0
        for _ in range(algorithm["epochs"]):
            if algorithm["value_norm"]:
                beta, flat = algorithm["value_norm_beta"], returns.reshape(agents, -1)
                for key, batch_moment in (
                    ("mean", flat.mean(1)),
                    ("mean_square", (flat**2).mean(1)),
                    ("debias", np.ones(agents)),
                ):
                    norm[key] = beta * norm[key] + (1 - beta) * batch_moment
            mean, std = (jnp.asarray(x, jnp.float32) for x in moments())
            for _ in range(algorithm["mini_batches"]):
                batch = jnp.asarray(r[f"rows.{index}"])
                actor.step(index, batch)
                critic.step(index, batch, mean, std)
                index += 1
        covered = np.sort(np.concatenate([r[f"rows.{i}"] for i in range(algorithm["mini_batches"])]))
        assert (covered == np.arange(steps * envs)).all(), "an epoch covers every sample once"
        actor.finish(index)
        critic.finish(index)
        for key, moment in norm.items():
            compare(f"value_norm.{key}", self.after[f"value_norm.{key}"], moment, GRADIENT)
        self.check_input_norms()
        print(
            f"{index} steps; largest error of a parameter, in moves of {index} learning rates: "
            f"actor {actor.worst:.1e}, critic {critic.worst:.1e}"
        )

    def networks(self, kind):
        """How many actors or critics differ in more than a bias; agent a has number a modulo that."""
        own_state = self.config["network"]["critic_state"] == "own"
        rows = len(self.before[f"{kind}.head.bias"])
        roles = 2 if kind == "actor" or own_state else rows
        return {"none": rows, "roles": roles, "all": 1}[self.config["network"]["parameter_sharing"]]

    def check_input_norms(self):
        """The normalisers after the update hold the samples' moments as well."""
        for name, data in (("observation_norm", self.record["observation"]), ("state_norm", self.record["state"][None])):
            if f"{name}.mean" not in self.before:
                continue
            rows = data[:, :-1].reshape(data.shape[0], -1, data.shape[-1]).astype(np.float64)
            count = self.before[f"{name}.count"][0]
            mean, m2 = self.before[f"{name}.mean"], self.before[f"{name}.m2"]
            total = count + rows.shape[1]
            merged = (mean * count + rows.sum(1)) / total
            square = m2 + count * mean**2 + (rows**2).sum(1) - total * merged**2
            if name == "observation_norm" and self.config["network"]["parameter_sharing"] != "none":
                networks = self.networks("actor")
                for rows in (slice(n, None, networks) for n in range(networks)):
                    pooled = merged[rows].mean(0)
                    square[rows] = (square[rows] + total * (merged[rows] - pooled) ** 2).mean(0)
                    merged[rows] = pooled
            compare(f"{name}.mean", self.after[f"{name}.mean"], merged, 1e-9)
            compare(f"{name}.m2", self.after[f"{name}.m2"], square, 1e-9)


if __name__ == "__main__":
    Learner(Path(sys.argv[1])).check()
    for failure in failures[:20]:
        print(failure, file=sys.stderr)
    sys.exit(1 if failures else 0)
