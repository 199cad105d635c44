#!/usr/bin/env python3
"""Measures MuJoCo on the workload of one environment of ours.

An env-step is a control step of 0.4 s: 400 Euler steps of 1 ms with a random command, uniform in ±0.8 rad/s for each joint, to the
model's velocity servos, and the number of contacts at its end. Every 50 env-steps the robot is put back to its home pose. Tasks,
observations and rewards are left out: it is the physics alone, called as MuJoCo's documentation of its Python bindings advises,
with all steps of a command in one call of `mj_step` (Todorov, Erez and Tassa, "MuJoCo: A physics engine for model-based control",
IROS 2012; mujoco.readthedocs.io, "Python" and "Computation").

The rate is per second of processor time of the one thread that computes, so that other load on the machine matters little.

Prints one JSON object: env_steps_per_s, contacts_per_step, steps (env-steps measured), processor_s, wall_s, mujoco (its version).
Exit status: 0 done, 1 the simulation diverged, 2 wrong usage, 3 a package is missing.
"""

import argparse
import json
import sys
import time

try:
    import mujoco
    import numpy as np
except ImportError as error:
    print(f"mujoco_physics: {error}: run `make venv-benches` and use .venv-benches/bin/python", file=sys.stderr)
    sys.exit(3)

SUBSTEP = 0.001  # s
SUBSTEPS = 400
EPISODE_STEPS = 50
MAX_RATE = 0.8  # rad/s
SEED = 1
DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


class Physics:
    """One environment: a model, its state and random commands."""

    def __init__(self, model, home):
        self.model, self.data, self.home = model, mujoco.MjData(model), home
        self.random = np.random.default_rng(SEED)
        self.steps = 0

    def step(self):
        """One env-step; returns the number of contacts."""
        if self.steps % EPISODE_STEPS == 0:
            mujoco.mj_resetData(self.model, self.data)
            self.data.qpos[:] = self.home
        self.steps += 1
        self.data.ctrl[:] = self.random.uniform(-MAX_RATE, MAX_RATE, self.model.nu)
        mujoco.mj_step(self.model, self.data, nstep=SUBSTEPS)
        return self.data.ncon

    def diverged(self):
        return any(self.data.warning[kind].number for kind in DIVERGED)


def home_of(model, angles):
    """Generalised positions at home: the joint angles given, the model's key `home`, or its reference pose."""
    if angles is not None:
        if len(angles) != model.nu:
            raise ValueError(f"--home has {len(angles)} angles, the model has {model.nu} joints with servos")
        home = model.qpos0.copy()
        home[model.jnt_qposadr[model.actuator_trnid[:, 0]]] = angles
        return home
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    return model.key_qpos[key] if key >= 0 else model.qpos0


def load(options):
    try:
        model = mujoco.MjModel.from_xml_path(options.model)
    except ValueError as error:
        raise ValueError(f"{options.model} is not a model: {error}") from error
    if model.nu == 0:
        raise ValueError(f"{options.model} has no actuators")
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.timestep = SUBSTEP
    if not options.contacts:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    return Physics(model, home_of(model, options.home))


def measure(physics, seconds):
    physics.step()
    contacts, first = 0, physics.steps
    wall, processor = time.perf_counter(), time.thread_time()
    while time.perf_counter() - wall < seconds:
        contacts += physics.step()
    processor, wall = time.thread_time() - processor, time.perf_counter() - wall
    steps = physics.steps - first
    return {
        "env_steps_per_s": steps / processor,
        "contacts_per_step": contacts / steps,
        "steps": steps,
        "processor_s": processor,
        "wall_s": wall,
        "mujoco": mujoco.__version__,
    }


def angles(text):
    return [float(angle) for angle in text.split(",")]


def positive(text):
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise ValueError
    return value


def parse():
    parser = argparse.ArgumentParser(prog="mujoco_physics", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.error = lambda message: parser.exit(2, f"{parser.prog}: {message}\n")
    parser.add_argument("model", metavar="MODEL.xml", help="the robot, as `octopus mjcf` writes it")
    parser.add_argument("--home", type=angles, metavar="Q1,Q2,…", help="joint angles at home, rad (key `home`, or reference pose)")
    parser.add_argument("--no-contacts", dest="contacts", action="store_false", help="let shapes pass through each other")
    parser.add_argument("--seconds", type=positive, default=10.0, help="how long to measure (10)")
    return parser, parser.parse_args()


def main():
    parser, options = parse()
    try:
        physics = load(options)
    except ValueError as error:
        parser.error(" ".join(str(error).split()))
    result = measure(physics, options.seconds)
    if physics.diverged():
        parser.exit(1, f"{parser.prog}: the simulation diverged\n")
    print(json.dumps(result))


if __name__ == "__main__":
    main()
