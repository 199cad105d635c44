#!/usr/bin/env python3
"""Draws somebody else's training beside ours: THEIRS.jsonl (of benchmarl_mappo.py), recorded curves of ours, runs of ours, the picture.

    .venv-trainers/bin/python tests/peers/trainers/compare.py theirs.jsonl deploy/policies/curves.json [RUN…] trainers.svg

Theirs is drawn over its processor time, which for one thread is the wall time on a machine that does nothing else; ours over wall time.
"""

import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("svg")
matplotlib.rcParams["svg.hashsalt"] = "spaceoctopus"
from matplotlib import pyplot  # noqa: E402


def lines(path):
    return [json.loads(line) for line in Path(path).read_text().splitlines()]


theirs, curves, *runs, out = sys.argv[1:]
theirs = lines(theirs)
last = theirs[-1]["env_steps"]
courses = {"BenchMARL 1.5.2, one thread": [(line["env_steps"], line["processor_s"], line["return"]) for line in theirs]}
for curve in json.loads(Path(curves).read_text())["curves"]:
    if curve["config"]["algorithm"]["name"] == "mappo" and curve["config"]["task"]["name"] == "trajectory":
        points = curve["points"]
        course = [point for point in zip(points["env_steps"], points["wall_s"], points["return_mean"]) if point[0] <= 1.05 * last]
        courses["octopus train, seed %d" % curve["config"]["run"]["seed"]] = course
for run in runs:
    courses[Path(run).name] = [(line["env_steps"], None, line["return_mean"]) for line in lines(Path(run) / "metrics.jsonl")]
figure, panels = pyplot.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
for name, course in courses.items():
    steps, seconds, returns = zip(*course)
    panels[0].plot([n / 1e6 for n in steps], returns, label=name)
    if None not in seconds:
        panels[1].plot(seconds, returns, label=name)
panels[0].set(xlabel="million env-steps", ylabel="return of an episode, mean over agents")
panels[1].set(xlabel="seconds")
for panel in panels:
    panel.grid(alpha=0.3)
panels[0].legend()
figure.savefig(out, metadata={"Date": None, "Creator": None})
for name, course in courses.items():
    tail = [value for *_, value in course[-5:]]
    print(f"{name}: {course[-1][0]:.0f} env-steps, {course[-1][1]} s, return {sum(tail) / len(tail):.0f} (last five points)")
