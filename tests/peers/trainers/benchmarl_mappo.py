#!/usr/bin/env python3
"""MAPPO as BenchMARL and TorchRL have it, on our simulator: does somebody else's trainer learn here, and how fast?

    make wheel && deploy/setup.py trainers
    .venv-trainers/bin/pip install --no-deps target/wheels/spaceoctopus-*.whl
    .venv-trainers/bin/python tests/peers/trainers/benchmarl_mappo.py --out theirs.jsonl

The trainer is theirs: collection, GAE, clipped loss, Adam, networks. Ours is the environment, a `torchrl.envs.EnvBase` around
`spaceoctopus.Batch`. What is learned with is that of preset `tuned` where BenchMARL has a place for it: environments, episode length,
discount, GAE, clipping, epochs, mini-batches, rates, hidden layers, actors that are shared by role, a critic an agent.
It has none for: the running normalisation of inputs, the squared-error clipping of values, schedules, and noise whose mean is squashed
(its actions are squashed themselves, within ±1).

Writes one JSON object a line, an iteration each: env_steps, seconds (wall time, since the training began), processor_s, collect_s, train_s, return
(undiscounted, of an episode, mean over agents and environments), position_error (m) and orientation_error (rad) after its last step.
"""

import argparse
import json
import sys
import time
from pathlib import Path

try:
    import numpy as np
    import spaceoctopus
    import torch
    from benchmarl.algorithms import MappoConfig
    from benchmarl.environments.common import TaskClass
    from benchmarl.experiment import Callback, Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig
    from tensordict import TensorDict
    from torchrl.data import Bounded, Composite, Unbounded
    from torchrl.envs import EnvBase
except ImportError as error:
    print(f"benchmarl_mappo: {error}: install tests/peers/trainers/requirements.txt and the wheel", file=sys.stderr)
    sys.exit(3)

# Agents that share a network, as they do in preset `tuned`: those that move the same joints of different arms.
GROUPS = {"shoulders": slice(0, None, 2), "wrists": slice(1, None, 2)}


class Environments(EnvBase):
    """A batch of environments as TorchRL steps them."""

    def __init__(self, n_envs, config, seed, device="cpu"):
        super().__init__(device=device, batch_size=[n_envs])
        self.batch = spaceoctopus.Batch(n_envs, config, threads=1)
        self.seed_of_run, self.begun = seed, False
        n, agents, seen = self.batch.observation.shape
        names = [f"agent_{index}" for index in range(agents)]
        self.group_map = {group: names[part] for group, part in GROUPS.items()}
        many = agents // len(GROUPS)

        def of_groups(**specs):
            groups = {group: Composite({name: spec.clone() for name, spec in specs.items()}, shape=[n, many]) for group in GROUPS}
            return Composite(groups, shape=[n])

        flag = {"shape": [n, 1], "dtype": torch.bool}
        self.observation_spec = of_groups(observation=Unbounded([n, many, seen]))
        self.action_spec = of_groups(action=Bounded(-1.0, 1.0, [n, many, 3]))
        self.reward_spec = of_groups(reward=Unbounded([n, many, 1]))
        self.done_spec = Composite({name: Unbounded(**flag) for name in ("done", "terminated", "truncated")}, shape=[n])

    def _shown(self, **more):
        over = torch.from_numpy(self.batch.truncated.copy())[:, None]
        shown = {"done": over, "truncated": over.clone(), "terminated": torch.zeros_like(over)}
        for group, part in GROUPS.items():
            # Copies: the next step fills the same memory.
            arrays = {name: torch.from_numpy(array[:, part].copy()) for name, array in more.items()}
            arrays["observation"] = torch.from_numpy(self.batch.observation[:, part].copy())
            shown[group] = TensorDict(arrays, arrays["observation"].shape[:2])
        return TensorDict(shown, self.batch_size)

    def _reset(self, tensordict=None, **_):
        self.batch.reset(None if self.begun else self.seed_of_run)
        self.begun = True
        return self._shown()

    def _step(self, tensordict):
        actions = np.empty((*self.batch.observation.shape[:2], 3), np.float32)
        for group, part in GROUPS.items():
            actions[:, part] = tensordict[group, "action"].numpy()
        self.batch.step(actions)
        if self.batch.truncated[0]:
            ERRORS[:] = [float(self.batch.position_error.mean()), float(self.batch.orientation_error.mean())]
        return self._shown(reward=self.batch.reward[..., None])

    def _set_seed(self, seed):
        self.seed_of_run, self.begun = seed, False


# After the last step of the last episodes.
ERRORS = [float("nan"), float("nan")]


class Space(TaskClass):
    """The task, as BenchMARL asks for it."""

    def get_env_fun(self, num_envs, continuous_actions, seed, device):
        return lambda: Environments(num_envs, self.config["config"], seed, device)

    def supports_continuous_actions(self):
        return True

    def supports_discrete_actions(self):
        return False

    def max_steps(self, env):
        return self.config["config"].episode_steps

    def has_render(self, env):
        return False

    def group_map(self, env):
        return env.group_map

    def observation_spec(self, env):
        return env.full_observation_spec_unbatched.clone()

    def info_spec(self, env):
        return None

    def state_spec(self, env):
        return None

    def action_mask_spec(self, env):
        return None

    def action_spec(self, env):
        return env.full_action_spec_unbatched

    @staticmethod
    def env_name():
        return "spaceoctopus"


class Record(Callback):
    """Writes a line an iteration."""

    def __init__(self, path):
        super().__init__()
        # By its name: BenchMARL pickles its callbacks.
        self.path, self.env_steps, self.begun = path.absolute(), 0, time.perf_counter()
        self.path.write_text("")
        self.processor, self.collected = time.process_time(), self.begun
        self.trained = self.begun

    def on_batch_collected(self, batch):
        self.collected = time.perf_counter()
        self.env_steps += batch.numel()
        paid = torch.stack([batch["next", group, "reward"].mean(-2).sum() for group in GROUPS]).mean()
        self.line = {"return": float(paid / batch["next", "done"].sum()), "position_error": ERRORS[0], "orientation_error": ERRORS[1]}

    def on_train_end(self, training, group):
        if group != list(GROUPS)[-1]:
            return
        now = time.perf_counter()
        line = {"env_steps": self.env_steps, "seconds": now - self.begun, "processor_s": time.process_time() - self.processor}
        line.update(collect_s=self.collected - self.trained, train_s=now - self.collected, **self.line)
        self.trained = now
        with open(self.path, "a") as file:
            print(json.dumps(line), file=file)


def parse():
    parser = argparse.ArgumentParser(prog="benchmarl_mappo", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="trajectory", choices=("trajectory", "reorientation"))
    parser.add_argument("--env-steps", type=int, default=320_000)
    parser.add_argument("--envs", type=int, default=16)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lr", type=float, default=5e-4)
    parser.add_argument("--normal", action="store_true", help="noise is normal and unbounded, as ours is, instead of squashed within ±1")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="where the lines go")
    return parser.parse_args()


def main():
    options = parse()
    torch.set_num_threads(options.threads)
    config = spaceoctopus.Config(task=options.task)
    frames = options.envs * config.episode_steps
    settings = ExperimentConfig.get_from_yaml()
    settings.share_policy_params = True
    settings.gamma, settings.lr = 0.95, options.lr
    settings.on_policy_n_envs_per_worker = options.envs
    settings.on_policy_collected_frames_per_batch = frames
    settings.on_policy_n_minibatch_iters, settings.on_policy_minibatch_size = 3, frames // 16
    settings.max_n_frames = -(-options.env_steps // frames) * frames
    settings.evaluation, settings.render, settings.loggers, settings.create_json = False, False, [], False
    settings.save_folder = options.out.parent
    algorithm = MappoConfig.get_from_yaml()
    algorithm.lmbda, algorithm.share_param_critic, algorithm.use_tanh_normal = 0.95, False, not options.normal
    networks = []
    for cells in ([256, 256, 256], [128, 128]):
        network = MlpConfig.get_from_yaml()
        network.num_cells, network.activation_class = cells, torch.nn.ELU
        networks.append(network)
    Experiment(
        task=Space("SPACE", {"config": config}),
        algorithm_config=algorithm,
        model_config=networks[0],
        critic_model_config=networks[1],
        seed=options.seed,
        config=settings,
        callbacks=[Record(options.out)],
    ).run()


if __name__ == "__main__":
    main()
