"""Open loop against `octopus simulate`: IN.csv OUT.csv PRECISION."""

import sys

import numpy as np
import spaceoctopus

actions = np.loadtxt(sys.argv[1], delimiter=",")
with open(sys.argv[2]) as file:
    header = file.readline().strip().split(",")
expected = np.loadtxt(sys.argv[2], delimiter=",", skiprows=1)
found = spaceoctopus.simulate(actions, "release", precision=sys.argv[3])
rows = np.concatenate(
    [
        found["t"][:, None],
        found["base_position"],
        found["base_quaternion"],
        found["joint_angles"].reshape(20, -1),
        found["base_linear_velocity"],
        found["base_angular_velocity"],
        found["joint_rates"].reshape(20, -1),
        found["hands"].reshape(20, -1),
        found["contacts"][:, None],
    ],
    axis=1,
)
assert rows.shape == expected.shape == (20, len(header)), (rows.shape, expected.shape)
if sys.argv[3] == "f64":
    assert np.array_equal(rows, expected)
else:
    # The file has as many digits as single precision needs.
    assert np.array_equal(rows[:, 1:].astype(np.float32), expected[:, 1:].astype(np.float32))
