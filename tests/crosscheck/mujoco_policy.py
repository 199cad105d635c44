"""A policy plays in MuJoCo: on a model that `octopus mjcf` wrote, with observations written from the guide alone.

    mujoco_policy.py CHECKPOINT MODEL.xml GOALS.json [--controller EXPORT] [--steps 200] [--delay 1] [--friction 5]
                     [--position 0.005] [--angle 0.01]

CHECKPOINT: a directory that `actor.py` reads, of task `trajectory` with layout `arm`; GOALS: what `octopus eval --save-goals` writes.
--controller: what `octopus export` wrote of it, whose C code looks for goal postures where the policy acts beside them; the dynamics, the
other observations and the networks are not from there.
--delay: control steps by which commands are late; --friction: dry friction in each joint (N m); --position, --angle: standard deviations
of what sensors add, each axis (m and m/s; rad and rad/s).

Prints JSON: for each episode a list of hands, each with the errors after every control step, position (m) and Euler angles (rad).
"""

import argparse
import ctypes
import json
import pathlib
import subprocess
import sys
import tempfile
import tomllib

import mujoco
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "deploy" / "policies"))
from actor import Actor  # noqa: E402
from arm_observation import arm_frame, from_euler, from_quaternion, observe, to_euler  # noqa: E402

TIME_STEP = 0.002


def arguments():
    parser = argparse.ArgumentParser()
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("model", type=pathlib.Path)
    parser.add_argument("goals", type=pathlib.Path)
    parser.add_argument("--controller", type=pathlib.Path)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--delay", type=int, default=0)
    parser.add_argument("--friction", type=float, default=0.0)
    parser.add_argument("--position", type=float, default=0.0)
    parser.add_argument("--angle", type=float, default=0.0)
    return parser.parse_args()


class Postures:
    """Goal postures, by the C code of an exported controller."""

    def __init__(self, controller, arms):
        self.arms = arms
        with tempfile.TemporaryDirectory() as place:
            library = pathlib.Path(place) / "postures.so"
            sources = [pathlib.Path(__file__).with_name("postures.c"), controller / "controller.c"]
            flags = ["-std=c99", "-O2", "-shared", "-fPIC", "-I", controller, "-o", library]
            subprocess.run(["cc", *flags, *sources, "-lm"], check=True)
            self.library = ctypes.CDLL(str(library))

    def begin(self):
        self.library.begin()

    def look(self, position, attitude, angles, goals):
        """Of each arm: good, free, what is left of six joints."""
        doubles = [np.ascontiguousarray(x, dtype=np.float64) for x in (position, attitude, angles, goals)]
        found = np.zeros((self.arms, 8), np.float32)
        pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in [*doubles, found]]
        status = self.library.look(*pointers)
        assert status == 0, f"status {status}"
        return found


def quaternion_product(a, b):
    (aw, *av), (bw, *bv) = a, b
    av, bv = np.array(av), np.array(bv)
    return np.array([aw * bw - av @ bv, *(aw * bv + bw * av + np.cross(av, bv))])


class Player:
    def __init__(self, options):
        self.options = options
        self.actor = Actor(options.checkpoint)
        self.postures = None
        if self.actor.config["task"].get("posture", {"seen": False})["seen"]:
            self.postures = Postures(options.controller, self.actor.n_agents // 2)
        self.robot = tomllib.loads((options.checkpoint / "robot.toml").read_text())
        self.frames = [arm_frame(arm) for arm in self.robot["arms"]]
        self.model = mujoco.MjModel.from_xml_path(str(options.model))
        self.model.opt.timestep = TIME_STEP
        self.model.dof_frictionloss[6:] = options.friction
        self.substeps = round(self.actor.config["env"]["control_period"] / TIME_STEP)
        self.sites = [self.model.site(f"{arm['name']}_hand").id for arm in self.robot["arms"]]

    def hands(self, data):
        return [(data.site_xpos[site].copy(), data.site_xmat[site].reshape(3, 3).copy()) for site in self.sites]

    def observations(self, data, poses, action, random):
        """Sensors err here, and nowhere else."""
        position, angle = self.options.position, self.options.angle
        goals = [(np.array(pose[:3]), from_euler(pose[3:])) for pose in poses]

        def err(values, deviation):
            return values + deviation * random.standard_normal(np.shape(values))

        def turned(attitude):
            return attitude @ from_euler(err(np.zeros(3), angle)) if angle else attitude

        base = (
            turned(from_quaternion(data.qpos[3:7])),
            err(data.qvel[:3], position),
            err(data.qvel[3:6], angle),
        )
        q, rates = err(data.qpos[7:], angle), err(data.qvel[6:], angle)
        postures = [None] * len(self.frames)
        if self.postures:
            at, attitude = data.qpos[:3], data.qpos[3:7]
            if position or angle:
                half = 0.5 * err(np.zeros(3), angle)
                attitude = quaternion_product(attitude, [np.sqrt(1.0 - half @ half), *half])
            postures = self.postures.look(err(at, position), attitude, q, poses)
        seen = []
        for arm, (at, attitude) in enumerate(self.hands(data)):
            joints = slice(6 * arm, 6 * arm + 6)
            hand = (err(at, position), turned(attitude))
            own = (q[joints], rates[joints], action[joints])
            description, frame = self.robot["arms"][arm], self.frames[arm]
            of_arm = observe(description, frame, base, hand, goals[arm], own, postures[arm])
            seen += [of_arm, of_arm]
        return np.array(seen)

    def episode(self, number, goals):
        random = np.random.default_rng(number)
        data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, data, 0)
        mujoco.mj_forward(self.model, data)
        action = np.zeros(6 * len(goals))
        waiting = [action] * self.options.delay
        if self.postures:
            self.postures.begin()
        courses = [{"position": [], "orientation": []} for _ in goals]
        for _ in range(self.options.steps):
            action = self.actor.actions(self.observations(data, goals, action, random))
            waiting.append(self.actor.scale * action)
            data.ctrl[:] = waiting.pop(0)
            for _ in range(self.substeps):
                mujoco.mj_step(self.model, data)
            mujoco.mj_forward(self.model, data)
            for goal, (at, attitude), course in zip(goals, self.hands(data), courses):
                course["position"].append(float(np.linalg.norm(goal[:3] - at)))
                course["orientation"].append(float(np.linalg.norm(goal[3:] - to_euler(attitude))))
        return courses


def main():
    options = arguments()
    player = Player(options)
    episodes = [episode["hands"] for episode in json.loads(options.goals.read_text())]
    json.dump([player.episode(number, goals) for number, goals in enumerate(episodes)], sys.stdout)


if __name__ == "__main__":
    main()
