#!/usr/bin/env python3
"""A search that Optuna proposes and octopus trains: ask, train, evaluate, tell.

    pip install optuna
    python deploy/sweeps/optuna_search.py --trials 20 --env-steps 400000 --out runs/search

Each proposal is a run below OUT, called by its number. The study is kept in OUT/optuna.log, so that the same command goes on
after an interruption: a run that was begun is resumed, and ends as if it had never stopped.
"""

import argparse
import json
import pathlib
import subprocess
import sys

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

# Errors that the paper reports: in their units, 1 is as good as the paper.
PAPER = {"position": 0.025, "orientation": 0.04, "base": 0.03}

# Exit code of a run whose learner or worker has failed for good: a gradient that is not finite, say.
FAILED_FOR_GOOD = 6
# So many trials in a row that fail are not the fault of what is tried.
MOST_FAILURES = 3


def octopus(*words):
    """Runs a command of octopus; returns what it prints as JSON."""
    done = subprocess.run(["octopus", *words, "--json"], stdout=subprocess.PIPE, check=True)
    return json.loads(done.stdout)


def propose(trial):
    """What is searched: keys of the configuration, as --set takes them."""
    actor_lr = trial.suggest_float("actor_lr", 1e-4, 2e-3, log=True)
    return {
        "optimizer.actor_lr": actor_lr,
        "optimizer.critic_lr": actor_lr,
        "network.initial_log_std": trial.suggest_float("initial_log_std", -1.5, 0.0),
        "algorithm.epochs": trial.suggest_int("epochs", 2, 6),
    }


def train(run, sets, budget):
    """Begins the run, or goes on with it."""
    quiet = ["--no-eval", "--quiet", "--listen=off"]
    if (run / "config.toml").is_file():
        ended = octopus("resume", str(run), *quiet)
    else:
        words = [f"--set={key}={value}" for key, value in sets.items()]
        ended = octopus("train", "--run-dir", str(run), *budget, *words, *quiet)
    if ended["stopped_by"] != "budget":
        sys.exit(f"{run}: stopped; the same command goes on")


def trains(run, sets, budget):
    """Whether it can be trained to the end; what fails is resumed once."""
    for _ in range(2):
        try:
            train(run, sets, budget)
            return True
        except subprocess.CalledProcessError as error:
            if error.returncode != FAILED_FOR_GOOD:
                raise
    return False


def score(run, episodes):
    """Mean error of the last 20 steps on held-out goals, in units of the paper's."""
    evaluation = octopus("eval", str(run), "--episodes", str(episodes))
    errors = [of["tail"]["mean"] / PAPER[of["error"]] for of in evaluation["overall"]]
    return sum(errors) / len(errors)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=20, help="how many are to be finished")
    parser.add_argument("--env-steps", type=int, default=400_000, help="budget of each")
    parser.add_argument("--episodes", type=int, default=50, help="of its evaluation")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE for all of them")
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("runs/search"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    budget = [f"--env-steps={args.env_steps}", *(f"--set={of}" for of in args.set)]

    storage = JournalStorage(JournalFileBackend(str(args.out / "optuna.log")))
    study = optuna.create_study(
        study_name="search",
        storage=storage,
        load_if_exists=True,
        sampler=optuna.samplers.TPESampler(seed=0),
    )
    # What was asked for and never told: the run is there, or is begun again.
    waiting = study.get_trials(states=(TrialState.RUNNING,))
    # Stopped before it was known what to try.
    for trial in [trial for trial in waiting if "sets" not in trial.user_attrs]:
        study.tell(trial.number, state=TrialState.FAIL)
        waiting.remove(trial)
    failures = 0
    while len(study.get_trials(states=(TrialState.COMPLETE,))) < args.trials:
        if waiting:
            number, sets = waiting[0].number, waiting.pop(0).user_attrs["sets"]
        else:
            trial = study.ask()
            number, sets = trial.number, propose(trial)
            trial.set_user_attr("sets", sets)
        run = args.out / f"trial-{number:04d}"
        # Everything else, a full disk say, ends the search, and the same command tries the trial again.
        if not trains(run, sets, budget):
            study.tell(number, state=TrialState.FAIL)
            failures += 1
            print(f"trial {number}: failed, see {run}/logs, with {sets}")
            if failures == MOST_FAILURES:
                sys.exit(f"{failures} trials in a row failed")
            continue
        failures = 0
        found = score(run, args.episodes)
        study.tell(number, found)
        print(f"trial {number}: score {found:.3f} with {sets}")
    best = study.best_trial
    print(json.dumps({"trial": best.number, "score": best.value, "sets": best.user_attrs["sets"]}))


if __name__ == "__main__":
    main()
