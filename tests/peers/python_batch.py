#!/usr/bin/env python3
"""Measures `spaceoctopus.Batch`, and MuJoCo's own rollout of the same robot, in one thread of Python.

An env-step is a control step of 0.4 s. Batch: actions of standard normal noise, as untrained actors explore, in float32; everything that
it shows is made, and nothing is done with it. MuJoCo: `mujoco.rollout`, its vector environment for Python, with 400 Euler steps of 1 ms
under a random command, uniform in ±0.8 rad/s; neither observations nor rewards.

Rates are env-steps per second of processor time of this process, so that other load on the machine matters little.

Prints one JSON object: batch and mujoco (rates by number of environments), versions.
Exit status: 0 done, 2 wrong usage, 3 a package is missing.
"""

import argparse
import json
import sys
import time

try:
    import mujoco
    import mujoco.rollout
    import numpy as np
    import spaceoctopus
except ImportError as error:
    print(f"python_batch: {error}: install the wheel of `make wheel` where the peers are, see `octopus bench --help`", file=sys.stderr)
    sys.exit(3)

SUBSTEP, SUBSTEPS = 0.001, 400
MAX_RATE = 0.8  # rad/s


def rate(n_envs, seconds, step):
    """Env-steps per second of processor time of `step`, which steps all environments."""
    steps, processor, wall = 0, time.process_time(), time.perf_counter()
    while steps == 0 or time.perf_counter() - wall < seconds:
        step()
        steps += 1
    return steps * n_envs / (time.process_time() - processor)


def batch(n_envs, options):
    environments = spaceoctopus.Batch(n_envs, options.config, robot=options.robot, threads=1)
    # Other noise in every step of an episode: the same again and again would drift, and robots that fold up touch themselves.
    shape = (environments.episode_steps, n_envs, environments.n_agents, 3)
    noise = np.random.default_rng(1).standard_normal(shape, np.float32)
    environments.reset(1)

    def step():
        if environments.truncated[0]:
            environments.reset()
        environments.step(noise[environments.steps])

    step()
    return rate(n_envs, options.seconds, step)


def rollout(n_envs, options):
    model = mujoco.MjModel.from_xml_path(options.model)
    model.opt.timestep, model.opt.integrator = SUBSTEP, mujoco.mjtIntegrator.mjINT_EULER
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home"))
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    home = np.empty(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, data, home, spec)
    states = np.tile(home, (n_envs, 1))
    random = np.random.default_rng(1)
    result = np.empty((n_envs, SUBSTEPS, len(home)))
    with mujoco.rollout.Rollout(nthread=0) as runner:

        def step():
            command = random.uniform(-MAX_RATE, MAX_RATE, (n_envs, 1, model.nu))
            control = np.broadcast_to(command, (n_envs, SUBSTEPS, model.nu))
            runner.rollout(model, data, states, np.ascontiguousarray(control), state=result)
            states[:] = result[:, -1]

        return rate(n_envs, options.seconds, step)


def main():
    parser = argparse.ArgumentParser(prog="python_batch", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.error = lambda message: parser.exit(2, f"{parser.prog}: {message}\n")
    parser.add_argument("config", metavar="CONFIG.toml")
    parser.add_argument("robot", metavar="ROBOT.toml")
    parser.add_argument("model", metavar="MODEL.xml", help="the same robot, as `octopus mjcf` writes it")
    parser.add_argument("--envs", type=lambda text: [int(n) for n in text.split(",")], default=[1, 16, 1024])
    parser.add_argument("--seconds", type=float, default=5.0, help="how long each measurement takes, at least (5)")
    options = parser.parse_args()
    found = {"spaceoctopus": spaceoctopus.__version__, "mujoco_version": mujoco.__version__, "batch": {}, "mujoco": {}}
    for n_envs in options.envs:
        found["batch"][str(n_envs)] = batch(n_envs, options)
        found["mujoco"][str(n_envs)] = rollout(n_envs, options)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
