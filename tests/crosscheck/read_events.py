"""Reads a run's event files with TensorBoard itself and compares them with metrics.jsonl.

    python read_events.py RUN_DIR/events

TensorBoard must show every iteration and every evaluation once, in order, also after a resume, and
with the numbers that metrics.jsonl and evaluations.jsonl hold (rounded to single precision, which is
all that a scalar has).
"""

import json
import math
import pathlib
import sys

import numpy as np
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

# Tag in TensorBoard and the place of the same number in a line.
COMPARED = {
    "returns/mean": lambda line: line["return_mean"],
    "returns/agent0": lambda line: line["returns"][0],
    "losses/kl": lambda line: line["kl"],
    "errors/position": lambda line: line["errors"]["position"],
    "accounting/trained": lambda line: line["accounting"]["trained"],
    "timing/update_s": lambda line: line["timing"]["update_s"],
}
OF_EVALUATIONS = {
    "evaluation/score": lambda line: line["score"],
    "evaluation/position": lambda line: line["errors"]["tail"]["position"],
    "evaluation/min_orientation": lambda line: line["errors"]["min"]["orientation"],
}


def read(path: pathlib.Path) -> list[dict]:
    return [json.loads(text) for text in path.read_text().splitlines()]


def main() -> None:
    events = pathlib.Path(sys.argv[1])
    iterations = read(events.parent / "metrics.jsonl")
    evaluations = read(events.parent / "evaluations.jsonl")
    compared = [(iterations, *item) for item in COMPARED.items()]
    if evaluations:
        compared += [(evaluations, *item) for item in OF_EVALUATIONS.items()]
    accumulator = EventAccumulator(str(events), size_guidance={"scalars": 0})
    accumulator.Reload()
    tags = accumulator.Tags()["scalars"]
    for lines, tag, value_of in compared:
        assert tag in tags, f"{tag} is not among {tags}"
        shown = [(scalar.step, scalar.value) for scalar in accumulator.Scalars(tag)]
        written = [(line["env_steps"], value_of(line)) for line in lines]
        written = [(step, value) for step, value in written if value is not None]
        assert [step for step, _ in shown] == [step for step, _ in written], (tag, shown, written)
        for (step, found), (_, expected) in zip(shown, written):
            same = np.float32(found) == np.float32(expected)
            assert same or math.isclose(found, expected, rel_tol=1e-6), (tag, step, found, expected)
    print(f"{len(tags)} tags, {len(iterations)} iterations, {len(evaluations)} evaluations")


if __name__ == "__main__":
    main()
