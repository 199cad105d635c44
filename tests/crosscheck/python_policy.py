"""A policy plays as `octopus eval` does: CHECKPOINT EXPECTED.json (35 episodes of 12 steps, seed 5)."""

import json
import sys

import numpy as np
import spaceoctopus

policy = spaceoctopus.Policy.load(sys.argv[1])
with open(sys.argv[2]) as file:
    expected = json.load(file)
assert policy.task == expected["task"] and policy.iteration == expected["iteration"] and policy.env_steps == expected["env_steps"]
found = policy.evaluate(35, 12, seed=5)
assert found["steps"] == expected["steps"] == 12
assert found["episodes"] == expected["episodes"], "to the last digit"

# One of the episodes alone.
played = policy.play(33, 12, seed=5)
one = expected["episodes"][33]
error = np.float32(np.linalg.norm(played["hand_error"][-1, 2, :3].astype(np.float64)))
assert abs(error - one["hands"][2]["position"]["last"]) < 1e-6
assert abs(np.linalg.norm(played["base_error"][-1]) - one["base"]["last"]) < 1e-6
assert np.array_equal(played["joint_angles"][-1].reshape(-1), np.float32(one["end"]["joints"]))
assert (played["contacts"].sum(axis=1) > 0).sum() == one["contact_steps"]

# And in a batch of its own configuration, on the same goals, by what it says step by step.
batch = spaceoctopus.Batch(35, policy.config, robot=policy.robot)
batch.reset(5, goals="evaluation")
smallest = batch.position_error.copy()
smallest[:] = np.inf
for _ in range(12):
    batch.step(policy.act(batch.observation))
    smallest = np.minimum(smallest, batch.position_error)
last = np.float32([[hand["position"]["last"] for hand in one["hands"]] for one in expected["episodes"]])
least = np.float32([[hand["position"]["min"] for hand in one["hands"]] for one in expected["episodes"]])
assert np.array_equal(batch.position_error, last) and np.array_equal(smallest, least), "the same bits"
assert np.array_equal(policy.act(batch.observation)[7], policy.act(batch.observation[7])), "alone as among others"

# One environment plays the episodes of an evaluation one after the other, unless it is told which.
alone = spaceoctopus.Batch(1, policy.config, robot=policy.robot)
batch.reset(5, goals="evaluation")
goals = [(batch.hand_goal[n].copy(), batch.base_goal[n].copy()) for n in range(9)]


def has_goals_of(episode):
    hands, base = goals[episode]
    assert np.array_equal(alone.hand_goal[0], hands) and np.array_equal(alone.base_goal[0], base), episode


alone.reset(5, goals="evaluation")
has_goals_of(0)
alone.reset()
has_goals_of(1)
alone.reset(first=7)
has_goals_of(7)
alone.reset()
has_goals_of(8)
alone.reset(5)
has_goals_of(0)

# A goal of one's own: where the hand is at home, it stays.
if policy.task == "trajectory":
    home = spaceoctopus.simulate(np.zeros((1, 24)), policy.robot, precision="f64")["hands"][0]
    goals = np.full((4, 6), np.nan)
    own = policy.play(0, 3, hand_goal=goals)
    assert all(np.array_equal(own[name], policy.play(0, 3)[name]) for name in own), "NaN keeps the episode's"
    goals[1] = [*home[1], 0.1, 0.2, 0.3]
    moved = policy.play(0, 1, hand_goal=goals)["hand_error"][0]
    assert np.abs(moved[1, :3]).max() < 0.2 and not np.array_equal(moved[1], own["hand_error"][0, 1])
