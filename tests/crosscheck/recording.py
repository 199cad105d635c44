"""Reads a recording as its viewers do: recording.py FILE.mcap FILE.csv FILE.urdf.

The frames must be where the URDF says that joints of these angles bring them, hands as far from their goals as the
errors say, and columns the same as messages.
"""

import csv
import json
import math
import pathlib
import sys
import xml.etree.ElementTree

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

recording, columns, urdf = map(pathlib.Path, sys.argv[1:])


def matrix(rotation, translation):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def of_quaternion(q):
    w, x, y, z = q.w, q.x, q.y, q.z
    assert abs(w * w + x * x + y * y + z * z - 1) < 1e-6
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def about(axis, angle):
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    rotation[i, i], rotation[i, j], rotation[j, i], rotation[j, j] = c, -s, s, c
    return rotation


def numbers(text):
    return [float(word) for word in text.split()]


robot = xml.etree.ElementTree.parse(urdf).getroot()
links = {link.get("name") for link in robot.findall("link")}
joints = {}
for joint in robot.findall("joint"):
    origin = joint.find("origin")
    roll, pitch, yaw = numbers(origin.get("rpy"))
    rotation = about(2, yaw) @ about(1, pitch) @ about(0, roll)
    parent, child = joint.find("parent").get("link"), joint.find("child").get("link")
    assert parent in links and child in links, (parent, child)
    joints[child] = parent, matrix(rotation, numbers(origin.get("xyz"))), joint.get("type")
assert len(joints) == len(links) - 1 and "base" in links
mass = sum(float(value.get("value")) for value in robot.iter("mass"))
assert mass > 400, mass

with recording.open("rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    schemas = {schema.name for schema in summary.schemas.values()}
    assert {"foxglove.FrameTransforms", "foxglove.JointStates", "foxglove.PosesInFrame"} < schemas, schemas
    messages = {}
    for _, channel, message, decoded in reader.iter_decoded_messages():
        messages.setdefault(channel.topic, []).append((message.log_time, decoded))
    attachments = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
    assert set(attachments) == {"robot.urdf", "robot.toml", "motion.json"}, attachments.keys()
    assert attachments["robot.urdf"] == urdf.read_bytes()
    motion = json.loads(attachments["motion.json"])
    (metadata,) = reader.iter_metadata()
    assert metadata.name == "spaceoctopus" and metadata.metadata["task"], metadata

with columns.open() as file:
    rows = list(csv.DictReader(file))
assert len(rows) > 5 and len(motion["states"]) == len(rows) == len(motion["commands"]) + 1
wanted = {"/tf", "/joint_states", "/joint_commands", "/goals", "/errors", "/contacts"}
assert set(messages) == wanted and all(len(found) == len(rows) for found in messages.values())

worst = 0.0
# Arms as columns name them, and where goals were.
arms_in_order = [name.removesuffix("_position_error_m") for name in rows[0] if name.endswith("_position_error_m")]
passed = {}
for step, row in enumerate(rows):
    at = {topic: found[step] for topic, found in messages.items()}
    for time, decoded in at.values():
        assert time == round(float(row["t"]) * 1e9), (time, row["t"])
    angles = {}
    for joint in at["/joint_states"][1].joints:
        angles[joint.name] = joint.position
        name = joint.name
        for value, column in (joint.position, "angle_rad"), (joint.velocity, "rate_rad_s"), (joint.effort, "torque_n_m"):
            assert np.float32(value) == np.float32(row[f"{name}_{column}"]), (name, column)
    for joint in at["/joint_commands"][1].joints:
        assert np.float32(joint.velocity) == np.float32(row[f"{joint.name}_command_rad_s"])
        assert not joint.HasField("position")
    world = {"world": np.eye(4)}
    for transform in at["/tf"][1].transforms:
        t = transform.translation
        pose = matrix(of_quaternion(transform.rotation), [t.x, t.y, t.z])
        child = transform.child_frame_id
        world[child] = world[transform.parent_frame_id] @ pose
        if child in joints:
            parent, fixed, kind = joints[child]
            assert parent == transform.parent_frame_id, child
            turn = about(2, angles[child]) if kind == "continuous" else np.eye(3)
            worst = max(worst, np.abs(fixed @ matrix(turn, [0, 0, 0]) - pose).max())
    assert links < set(world), links - set(world)
    arms = [name.removesuffix("_hand") for name in links if name.endswith("_hand")]
    errors = at["/errors"][1]
    assert len(errors.position_m) == len(arms)
    task = metadata.metadata["task"]
    # Every hand has a goal, the hands of the first half of the arms beside the base, or the base alone.
    reaching = {"trajectory": arms, "capture": arms, "mixed": arms_in_order[: len(arms) // 2], "reorientation": []}[task]
    poses = at["/goals"][1].poses
    goals = {name.removesuffix("_goal"): pose for name, pose in world.items() if name.endswith("_goal")}
    assert set(goals) == set(reaching) and at["/goals"][1].frame_id == "world"
    assert len(poses) == len(reaching) + (task in ("mixed", "reorientation"))
    for arm, goal in goals.items():
        found, column = np.linalg.norm(world[f"{arm}_hand"][:3, 3] - goal[:3, 3]), f"{arm}_position_error_m"
        assert np.isclose(found, float(row[column]), atol=1e-5), (step, arm, found, row[column])
        passed.setdefault(arm, []).append(goal[:3, 3])
    for contact in at["/contacts"][1].contacts:
        assert contact.on in links and contact.by in links, contact
# Goals of `capture` go on from step to step, others stay.
for arm, places in passed.items():
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert (steps > 1e-6).all() if task == "capture" else not steps.any(), (arm, steps)
# Frames come from single precision, relative to each other, some metres from the world's origin.
assert worst < 1e-5, worst
turned = next(column for column in rows[0] if column.startswith(arms[0]) and column.endswith("_angle_rad"))
moved = np.ptp([float(row[turned]) for row in rows])
print(f"{len(rows)} moments, {len(world)} frames, off by {worst:.1g}; a shoulder moved by {moved:.2f} rad")
