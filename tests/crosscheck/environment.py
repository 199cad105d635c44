"""The environment by its description in the guide, against the worked example: environment.py REPOSITORY.

Written from `deploy/guide/src/environment.md` and the robot's file alone, as a user would.
"""

import json
import pathlib
import sys
import tomllib

import numpy as np

repository = pathlib.Path(sys.argv[1])
policies = repository / "deploy" / "policies"
sys.path.insert(0, str(policies))
from actor import Actor  # noqa: E402
from arm_observation import about, arm_frame, from_euler, from_quaternion, observe  # noqa: E402

example = json.loads((policies / "example.json").read_text())
robot = tomllib.loads((policies / "trajectory" / "robot.toml").read_text())
state = {key: np.array(value) for key, value in example["state"].items()}


def hand(mount, q):
    """Pose of a hand in the base, by the Denavit-Hartenberg rows."""
    degrees = np.pi / 180
    rotation = mount @ from_euler(np.array(robot["pedestal"].get("euler_deg", [0, 0, 0])) * degrees)
    position = np.zeros(3)
    for link, angle in zip(robot["links"], q):
        row = link["dh"]
        rotation = rotation @ about(2, angle)
        position = position + rotation @ [row["a"], 0, row["d"]]
        rotation = rotation @ about(0, row["alpha_deg"] * degrees)
    tool = robot["tool"]
    return position + rotation @ tool["position"], rotation @ from_euler(np.array(tool.get("euler_deg", [0, 0, 0])) * degrees)


base = from_quaternion(state["base_quaternion"])
for number, arm in enumerate(robot["arms"]):
    joints = slice(6 * number, 6 * number + 6)
    home, q = np.array(arm["home"]), state["q"][joints]
    mount = from_euler(np.array(arm["mount_euler_deg"]) * np.pi / 180)
    offset, turned = hand(mount, q)
    position = state["base_position"] + base @ (np.array(arm["mount_position"]) + offset)
    attitude = base @ turned
    assert np.allclose(position, example["hands"][number]["position"], atol=1e-8), (number, position)
    assert np.allclose(attitude, from_euler(example["hands"][number]["euler"]), atol=1e-8), (number, attitude)

    goal = example["goals"][number]
    assert (np.cos(home[0]) < 0) == (number + 1 in (1, 4)), "arms 1 and 4 are reversed"
    frame = arm_frame(arm)
    table = [
        ([-1, 0, 0], [0, 0, 1], [0, 1, 0]),
        ([1, 0, 0], [0, 0, 1], [0, -1, 0]),
        ([1, 0, 0], [0, 1, 0], [0, 0, 1]),
        ([-1, 0, 0], [0, 1, 0], [0, 0, -1]),
    ]
    assert np.allclose(frame, table[number], atol=1e-12), (number, frame)
    seen = observe(
        arm,
        frame,
        (base, state["base_velocity"], state["base_angular_velocity"]),
        (position, attitude),
        (np.array(goal["position"]), from_euler(goal["euler"])),
        (q, state["qd"][joints], state["last_action"][joints]),
        example["postures"][number],
    )
    for agent in (2 * number, 2 * number + 1):
        wrong = np.abs(seen - example["observations"][agent])
        assert wrong.max() < 1e-6, f"agent {agent}, number {wrong.argmax()}: {seen[wrong.argmax()]}"

    # Goals are offsets from home; here the ranges that the guide lists.
    ranges = {
        1: ([-0.10, -0.45, -0.15], [0.20, -0.15, 0.15], [-0.2, -0.15, -0.3], [0.3, 0.35, 0.2]),
        2: ([-0.10, 0.15, -0.15], [0.20, 0.45, 0.15], [-0.2, -0.35, -0.2], [0.3, 0.15, 0.3]),
        3: ([-0.10, -0.15, -0.45], [0.20, 0.15, -0.15], [0.5, -0.15, -0.3], [1.0, 0.35, 0.2]),
        4: ([-0.10, -0.15, 0.15], [0.20, 0.15, 0.45], [0.5, -0.35, -0.2], [1.0, 0.15, 0.3]),
    }[number + 1]
    at_home = example["home_hands"][number]
    for what, (low, high) in (("position", ranges[:2]), ("euler", ranges[2:])):
        moved = np.array(goal[what]) - at_home[what]
        assert (moved > np.array(low) - 1e-9).all() and (moved < np.array(high) + 1e-9).all(), (number, what, moved)

actor = Actor(policies / "trajectory")
observations = np.array(example["observations"])
assert np.abs(actor.actions(observations) - example["actions"]).max() < 1e-5
assert np.abs(actor.commands(observations) - example["commands"]).max() < 1e-5
