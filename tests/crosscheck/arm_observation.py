"""Observations of layout `arm`, written from `deploy/guide/src/environment.md` and the robot's file alone, as a user would."""

import numpy as np


def about(axis, angle):
    """Rotation about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    turn = np.eye(3)
    turn[[i, j], [i, j]] = c
    turn[i, j], turn[j, i] = -s, s
    return turn


def from_euler(angles):
    """R = Rx(a) Ry(b) Rz(c)."""
    return about(0, angles[0]) @ about(1, angles[1]) @ about(2, angles[2])


def to_euler(turn):
    """(a, b, c) of R = Rx(a) Ry(b) Rz(c)."""
    return np.array(
        [
            np.arctan2(-turn[1, 2], turn[2, 2]),
            np.arcsin(np.clip(turn[0, 2], -1, 1)),
            np.arctan2(-turn[0, 1], turn[0, 0]),
        ]
    )


def from_quaternion(q):
    w, (x, y, z) = q[0], q[1:]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def rotation_error(goal, actual):
    """Axis of the rotation from actual to goal, times 2 sin(half its angle)."""
    turn = goal @ actual.T
    angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
    twice_sine = 2 * np.sin(angle)
    if twice_sine < 1e-12:
        return np.zeros(3)
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / twice_sine
    return 2 * np.sin(angle / 2) * axis


def arm_frame(arm):
    """Axes of an arm's frame in the base's, as rows; `arm` is the arm in the robot's file."""
    mount = from_euler(np.array(arm["mount_euler_deg"]) * np.pi / 180)
    side = -1.0 if np.cos(arm["home"][0]) < 0 else 1.0
    return (mount * [side, side, 1.0]).T


def observe(arm, frame, base, hand, goal, joints, posture=None):
    """What both agents of an arm see.

    base: attitude (3, 3), velocity (world), angular velocity (body); hand and goal: position and attitude (world);
    joints: angles, rates, last actions of the arm's; posture: of a policy that sees it, whether it is good, whether it is free,
    and what is left of it.
    """
    posture = [] if posture is None else [*posture, *np.tanh(np.array(posture[2:]) / 0.1)]
    (attitude, velocity, turning), (q, rates, last_action) = base, joints
    home = np.array(arm["home"])
    difference = attitude.T @ (goal[0] - hand[0])
    turn = attitude.T @ rotation_error(goal[1], hand[1])
    return np.concatenate(
        [
            frame @ attitude.T @ velocity,
            frame @ turning,
            np.sin(q - home),
            np.cos(q - home),
            rates,
            frame @ difference,
            frame @ turn,
            frame @ np.tanh(difference / 0.05),
            frame @ np.tanh(difference / 0.015),
            frame @ np.tanh(turn / 0.08),
            frame @ np.tanh(turn / 0.025),
            posture,
            last_action,
        ]
    )
