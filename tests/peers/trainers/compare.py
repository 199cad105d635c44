#!/usr/bin/env python3
"""Draws somebody else's training beside ours: THEIRS.jsonl (of benchmarl_mappo.py), a run directory of ours, and the picture.

    octopus train trajectory --env-steps 320000 --workers 1 --set run.learner_threads=1 --run-dir ours
    .venv-trainers/bin/python tests/peers/trainers/compare.py theirs.jsonl ours trainers.svg
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


theirs, ours = lines(sys.argv[1]), lines(Path(sys.argv[2]) / "metrics.jsonl")
courses = {
    "BenchMARL 1.5.2": [(line["env_steps"], line["seconds"], line["return"]) for line in theirs],
    "octopus train": [(line["env_steps"], line["wall_s"], line["return_mean"]) for line in ours],
}
figure, panels = pyplot.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
for name, course in courses.items():
    steps, seconds, returns = zip(*course)
    panels[0].plot([n / 1e6 for n in steps], returns, label=name)
    panels[1].plot([s / 60 for s in seconds], returns, label=name)
panels[0].set(xlabel="million env-steps", ylabel="return of an episode, mean over agents")
panels[1].set(xlabel="minutes of wall time, one thread each")
panels[1].set_xscale("log")
for panel in panels:
    panel.grid(alpha=0.3)
panels[0].legend()
figure.savefig(sys.argv[3], metadata={"Date": None, "Creator": None})
for name, course in courses.items():
    tail = [value for *_, value in course[-5:]]
    print(f"{name}: {course[-1][0]} env-steps in {course[-1][1]:.0f} s, return {sum(tail) / len(tail):.1f} (last five iterations)")
