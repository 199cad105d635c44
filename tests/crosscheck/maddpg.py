"""Checks MADDPG's updates of an iteration against an implementation in JAX and Optax.

Usage: maddpg.py DIRECTORY, with in it

  config.toml           the run's configuration
  before.safetensors    the training state before the iteration
  after.safetensors     the training state after it; its replay is the one that was sampled from
  record.safetensors    the sampled rows, and what the learner computed on its way: targets, unclipped
                        gradients, losses

As in learning.py, nothing follows the learner's code: the formulas are equations 5 and 6 of Lowe et al.
2017, gradients are jax.grad's, the optimiser is optax.adam. Tolerances are those of learning.py, for the
same reasons.
"""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
from learning import DRIFTED, GRADIENT, Learner, compare, failures, network, standardise


class Maddpg(Learner):
    def seen(self, observation, state):
        """What actors [A, B, O] and critics [B, S] see."""
        own = [self.normalise("observation_norm", observation[:, a], a) for a in range(self.agents)]
        state = self.normalise("state_norm", state, 0)
        if self.config["network"]["input_norm"] == "layer_norm":
            own, state = [standardise(x) for x in own], standardise(state)
        return jnp.stack([jnp.asarray(x) for x in own]), jnp.asarray(state)

    def act(self, p, x):
        """In units of the limit."""
        return jnp.tanh(self.layers(p, x))

    def value(self, p, state, actions):
        """One critic: states [B, S], all agents' actions [A, B, U] in units of the limit."""
        return self.layers(p, jnp.concatenate([state, *actions], -1))[:, 0]

    def check(self):
        algorithm, optimizer, r = self.config["algorithm"], self.config["optimizer"], self.record
        settings, agents = algorithm["maddpg"], self.agents
        replay = {k: self.after[f"replay.{k}"] for k in ("observation", "state", "action", "reward", "future")}
        slots, steps = replay["future"].shape
        held = min(int(self.after["replay.episodes"][0]), slots) * steps
        factor = 1.0
        if optimizer["schedule"] == "linear":
            factor = 1 - int(self.before["counters.env_steps"][0]) / self.config["run"]["env_steps"]
        rates = {kind: optimizer[f"{kind}_lr"] * factor for kind in ("actor", "critic")}
        limit = algorithm["max_grad_norm"]
        clip = optax.clip_by_global_norm(limit) if limit > 0 else optax.identity()
        adam = {
            kind: optax.chain(
                clip,
                optax.adam(rate, b1=optimizer["beta1"], b2=optimizer["beta2"], eps=optimizer["epsilon"]),
            )
            for kind, rate in rates.items()
        }
        now = {kind: network(kind, self.before, agents) for kind in rates}
        target = {kind: network(f"target_{kind}", self.before, agents) for kind in rates}
        optimiser_state = {}
        for kind in rates:
            moments = {}
            for moment in ("m", "v"):
                names = {f"{kind}.{n}": self.before[f"{kind}.adam.{moment}.{n}"] for n in now[kind][0]}
                moments[moment] = network(kind, names, agents)
            optimiser_state[kind] = []
            for a, tree in enumerate(now[kind]):
                state = adam[kind].init(tree)
                inner = state[1][0]._replace(
                    count=jnp.asarray(self.before[f"{kind}.adam.steps"][a], jnp.int32),
                    mu=moments["m"][a],
                    nu=moments["v"][a],
                )
                optimiser_state[kind].append((state[0], (inner, *state[1][1:])))

        def critic_loss(p, state, actions, y):
            return ((self.value(p, state, actions) - y) ** 2).mean()

        def actor_loss(p, a, critic, own, state, actions):
            actions = actions.at[a].set(self.act(p, own[a]))
            return -self.value(critic, state, actions).mean()

        critic_gradient = jax.jit(jax.value_and_grad(critic_loss))
        actor_gradient = jax.jit(jax.value_and_grad(actor_loss), static_argnums=1)

        def descend(kind, gradients):
            for a, gradient in enumerate(gradients):
                update, optimiser_state[kind][a] = adam[kind].update(
                    gradient, optimiser_state[kind][a], now[kind][a]
                )
                now[kind][a] = optax.apply_updates(now[kind][a], update)

        def record(kind, index, losses, gradients, tolerance):
            scale = max(np.abs(np.asarray(losses)).max(), 1.0)
            compare(f"{kind} loss {index}", r[f"loss.{index}.{kind}"], losses, tolerance, scale)
            for name in gradients[0]:
                theirs = np.stack([g[name] for g in gradients])
                ours = r[f"gradient.{index}.{kind}.{name}"]
                compare(f"{kind} gradient {index} of {name}", ours, theirs, tolerance)

        count = 0
        while f"rows.{count}" in r:
            rows = r[f"rows.{count}"]
            assert ((0 <= rows) & (rows < held)).all(), "rows that are there"
            slot, step = rows // steps, rows % steps

            def look(after):
                flat = replay["observation"][slot, step + after]
                state = replay["state"][slot, step + after] if replay["state"].size else flat
                return self.seen(flat.reshape(len(rows), agents, -1), state)

            own, state = look(0)
            next_own, next_state = look(1)
            taken = replay["action"][slot, step].reshape(len(rows), agents, -1).transpose(1, 0, 2)
            taken = jnp.asarray(taken / settings["action_limit"])
            following = jnp.stack([self.act(p, next_own[a]) for a, p in enumerate(target["actor"])])
            y = [
                replay["reward"][slot, step, a]
                + algorithm["gamma"] * replay["future"][slot, step] * self.value(p, next_state, following)
                for a, p in enumerate(target["critic"])
            ]
            tolerance = GRADIENT if count == 0 else DRIFTED
            compare(f"target {count}", r[f"target.{count}"], np.stack(y), tolerance)
            parts = [critic_gradient(p, state, taken, y[a]) for a, p in enumerate(now["critic"])]
            record("critic", count, [p[0] for p in parts], [p[1] for p in parts], tolerance)
            descend("critic", [p[1] for p in parts])
            # The actors' first gradient is that of critics which have moved by a step already.
            parts = [
                actor_gradient(p, a, now["critic"][a], own, state, taken)
                for a, p in enumerate(now["actor"])
            ]
            record("actor", count, [p[0] for p in parts], [p[1] for p in parts], DRIFTED)
            descend("actor", [p[1] for p in parts])
            tau = settings["soft_update"]
            for kind in rates:
                target[kind] = [
                    jax.tree.map(lambda old, new: tau * new + (1 - tau) * old, old, new)
                    for old, new in zip(target[kind], now[kind])
                ]
            count += 1

        worst = 0.0
        for kind, rate in rates.items():
            for prefix, trees in ((kind, now[kind]), (f"target_{kind}", target[kind])):
                for name in trees[0]:
                    theirs = np.stack([p[name] for p in trees])
                    ours, scale = self.after[f"{prefix}.{name}"], rate * count
                    worst = max(worst, compare(f"{prefix} {name} after", ours, theirs, 2e-2, scale))
        print(f"{count} updates; largest error of a parameter, in moves of {count} learning rates: {worst:.1e}")


if __name__ == "__main__":
    Maddpg(Path(sys.argv[1])).check()
    for failure in failures[:20]:
        print(failure, file=sys.stderr)
    sys.exit(1 if failures else 0)
