"""What a person may do wrong, and what must not be lost by it: REPOSITORY."""

import copy
import json
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import spaceoctopus

ROOT = Path(sys.argv[1])
POLICY = ROOT / "deploy" / "policies" / "trajectory"
SHORT = ["task.episode_steps=9"]
ZERO = np.zeros((3, 8, 3), np.float32)
# What runs in the background of a script is started deaf to it.
signal.signal(signal.SIGINT, signal.default_int_handler)


def refused(kinds, words, work, *arguments, **keywords):
    """Asserts that `work` raises one of `kinds` and says `words`. Whatever else it raises ends the test, a panic too."""
    try:
        work(*arguments, **keywords)
    except kinds as error:
        assert words in str(error), "%r is not in %r" % (words, str(error))
        return
    raise AssertionError("%r was not refused" % (words,))


def batch(n=3, **keywords):
    made = spaceoctopus.Batch(n, set=SHORT, **keywords)
    made.reset(seed=1)
    return made


# --- numbers and shapes -----------------------------------------------------------------------------------------
one, twin = batch(), batch()
before = [one.observation.copy(), one.reward.copy(), one.robot_state.copy()]
for wrong, kinds, words in (
    (np.zeros((3, 24), np.float32), ValueError, "actions has shape (3, 24), expected (3, 8, 3)"),
    (np.zeros((2, 8, 3)), ValueError, "shape (2, 8, 3)"),
    (np.zeros(0), ValueError, "shape (0,)"),
    (0.5, ValueError, "expected (3, 8, 3)"),
    (None, TypeError, "type object"),
    ("right", TypeError, "real numbers"),
    (np.zeros((3, 8, 3), complex), TypeError, "complex128"),
    (np.zeros((3, 8, 3), bool), TypeError, "bool"),
    (np.full((3, 8, 3), None), TypeError, "object"),
    (np.zeros((3, 8, 3), "datetime64[s]"), TypeError, "datetime64"),
    (np.full((3, 8, 3), 1e300), ValueError, "environment 0, agent 0: action 0 is inf"),
    ([[1.0], [1.0, 2.0]], ValueError, ""),
):
    refused(kinds, words, one.step, wrong)
for value in (np.nan, np.inf, -np.inf):
    wrong = ZERO.copy()
    wrong[2, 5, 1] = value
    refused(ValueError, "environment 2, agent 5: action 1 is", one.step, wrong)
assert one.steps == 0 and all(map(np.array_equal, before, [one.observation, one.reward, one.robot_state])), "nothing has changed"

# Whatever holds real numbers will do, and does the same.
actions = np.random.default_rng(1).uniform(-2, 2, (3, 8, 3)).astype(np.float32)
given = [actions, actions.astype(np.float64), actions.tolist(), np.asfortranarray(actions), actions.astype(">f4")]
given += [np.repeat(actions, 2, axis=0)[::2], actions[::-1][::-1]]
frozen = actions.copy()
frozen.flags.writeable = False
for actions_of_a_kind in [*given, frozen]:
    one.step(actions_of_a_kind)
    twin.step(actions)
    assert np.array_equal(one.observation, twin.observation)
one.step(np.full((3, 8, 3), 3))  # beyond the limits, and whole numbers
assert one.steps == 9 and one.truncated.all()
refused(RuntimeError, "the episode is over after 9 steps: reset first", one.step, ZERO)

# Actions that lie in an array that a step fills would change under it.
one.reset()
refused((RuntimeError, TypeError, ValueError), "", one.step, one.hand_goal.reshape(3, 8, 3))
one.step(ZERO)

# An array that is locked cannot be filled.
one.reset()
one.reward.flags.writeable = False
refused((RuntimeError, TypeError, ValueError), "", one.step, ZERO)
one.reward.flags.writeable = True
one.reset()
one.step(ZERO)

for n, kinds in ((0, ValueError), (-1, ValueError), (1 << 40, ValueError), (1 << 64, ValueError), (1.5, TypeError), ("3", TypeError)):
    refused(kinds, "", spaceoctopus.Batch, n)
refused(ValueError, "threads is 0", spaceoctopus.Batch, 1, threads=0)
refused(ValueError, "-1 is out of range, expected 0 to 18446744073709551615", spaceoctopus.Batch, 1, threads=-1)
refused(ValueError, "-1 is out of range", one.reset, -1)
refused(ValueError, "18446744073709551616 is out of range", one.reset, 1 << 64)
for index in ({"first": 1 << 32}, {"first": -1}, {"iteration": np.int64(-1)}):
    refused(ValueError, "is out of range, expected 0 to 4294967295", one.reset, 1, **index)
refused(ValueError, "random numbers are addressed for", one.reset, 1, first=(1 << 32) - 2)
refused(ValueError, 'expected "training" or "evaluation"', one.reset, goals="easy")
refused(ValueError, "iteration is 5: goals of an evaluation are those of iteration 0", one.reset, iteration=5, goals="evaluation")
config, robot = spaceoctopus.Config("paper", set=SHORT), spaceoctopus.Robot("release")
assert pickle.loads(pickle.dumps(config)) == config != spaceoctopus.Config("paper")
assert copy.deepcopy(robot).to_toml() == robot.to_toml()
refused(TypeError, "", pickle.dumps, one)
refused(TypeError, "", copy.deepcopy, one)

with np.errstate(all="raise"):
    tiny = batch()
    tiny.step(np.full((3, 8, 3), 1e-50))

# --- the moment of a call ---------------------------------------------------------------------------------------
fresh = spaceoctopus.Batch(3, set=SHORT)
assert fresh.steps is None
refused(RuntimeError, "no episode has begun yet: reset first", fresh.step, ZERO)
shown = one.observation
kept = shown.copy()
one.close()
one.close()
assert one.closed and one.steps is None
refused(RuntimeError, "the batch is closed", one.step, ZERO)
refused(RuntimeError, "the batch is closed", one.reset)
assert np.array_equal(shown, kept), "arrays outlive their batch"
del one
assert np.array_equal(shown, kept)

for make in (spaceoctopus.ParallelEnv, spaceoctopus.VectorEnv, lambda **keywords: spaceoctopus.Batch(1, **keywords)):
    refused(TypeError, "str", make, set=SHORT[0])
env = spaceoctopus.ParallelEnv(set=SHORT)
env.reset(seed=1)
actions_by_name = {agent: np.zeros(3, np.float32) for agent in env.agents}
refused(ValueError, "actions have none for 'plus_y_wrist'", env.step, {a: v for a, v in actions_by_name.items() if a != "plus_y_wrist"})
refused(ValueError, "who is no agent", env.step, {**actions_by_name, "nobody": np.zeros(3)})
refused(ValueError, "has shape (4,), expected (3,)", env.step, {**actions_by_name, "plus_y_wrist": np.zeros(4)})
refused(TypeError, "expected real numbers", env.step, {**actions_by_name, "plus_y_wrist": np.array(["a", "b", "c"])})
refused(ValueError, "agent 1: action 2 is NaN", env.step, {**actions_by_name, "plus_y_wrist": np.array([0, 0, np.nan])})
refused(ValueError, "render_mode", spaceoctopus.ParallelEnv, render_mode="human")
refused(ValueError, "-1 is out of range", env.reset, seed=-1)
env.close()
refused(RuntimeError, "closed", env.step, actions_by_name)
refused(RuntimeError, "closed", env.reset)
envs = spaceoctopus.VectorEnv(3, set=SHORT)
refused(RuntimeError, "reset first", envs.step, np.zeros((3, 24)))
envs.reset(seed=np.int64(1))
refused(ValueError, "expected (3, 24)", envs.step, np.zeros((3, 8, 3)))
refused(ValueError, "are not known", envs.reset, options={"speed": 2})
refused(ValueError, "-1 is out of range", envs.reset, seed=-1)
refused(ValueError, "seed is a list", envs.reset, seed=[1, 2, 3])
refused(ValueError, "begin and end together", envs.reset, options={"reset_mask": np.array([True, False, True])})
refused(ValueError, "observe is", spaceoctopus.VectorEnv, observe="nothing")
refused(ValueError, "", spaceoctopus.VectorEnv, autoreset_mode="sometimes")
envs.close()
refused(RuntimeError, "closed", envs.step, np.zeros((3, 24)))
refused(AttributeError, "has no attribute", getattr, spaceoctopus, "Batches")

# --- files ------------------------------------------------------------------------------------------------------
with tempfile.TemporaryDirectory() as folder:
    folder = Path(folder)
    missing, fifo, garbage = folder / "missing", folder / "fifo", folder / "garbage"
    os.mkfifo(fifo)
    garbage.write_bytes(b"\xff\xfe = 1")
    for make in (spaceoctopus.Config, spaceoctopus.Robot, lambda path: spaceoctopus.Batch(1, path), spaceoctopus.Policy.load):
        refused(ValueError, "missing", make, missing)
        for path in (folder, fifo, garbage):
            refused(ValueError, str(path), make, path)
        refused(TypeError, "", make, 3)
    refused(ValueError, "is a preset", spaceoctopus.Config, "tuned", preset="paper")
    refused(ValueError, "preset", spaceoctopus.Config, preset="papers")
    refused(ValueError, 'task "walk"', spaceoctopus.Config, task="walk")
    refused(TypeError, "a Config is complete", spaceoctopus.Batch, 1, spaceoctopus.Config(), set=SHORT)

    def damaged(name, change):
        place = folder / name
        shutil.copytree(POLICY, place)
        change(place)
        return place

    def flip(place):
        content = bytearray((place / "policy.safetensors").read_bytes())
        content[-7] ^= 1
        (place / "policy.safetensors").write_bytes(content)

    def manifest(**changes):
        def change(place):
            content = json.loads((place / "manifest.json").read_text())
            (place / "manifest.json").write_text(json.dumps({**content, **changes}))

        return change

    load = spaceoctopus.Policy.load
    refused(ValueError, "content differs from its BLAKE3 hash", load, damaged("flipped", flip))
    refused(ValueError, "bytes, the manifest says", load, damaged("short", lambda place: (place / "robot.toml").write_text("")))
    refused(ValueError, "No such file", load, damaged("gone", lambda place: (place / "policy.safetensors").unlink()))
    refused(ValueError, "format 9, this version reads 1", load, damaged("newer", manifest(format=9)))
    refused(ValueError, "does not list", load, damaged("unlisted", manifest(files={})))
    refused(ValueError, "not a manifest", load, damaged("no-json", lambda place: (place / "manifest.json").write_text("[]")))
    two_arm = ROOT / "sim-worker" / "simulator" / "robots" / "two-arm.toml"
    refused(ValueError, "the policy moves 4 arms of 6 joints, the robot `two-arm` has 2 arms of 6 joints", load, POLICY, robot=two_arm)

    # As a run keeps them.
    run = folder / "run"

    def keep(iteration, score, **labels):
        place = run / "checkpoints" / ("iteration-%08d" % iteration)
        shutil.copytree(POLICY, place)
        # What is in it nobody reads here, but its hash is looked at.
        state = place / "state.safetensors"
        shutil.copy(place / "robot.toml", state)
        files = json.loads((place / "manifest.json").read_text())["files"]
        manifest(iteration=iteration, digest="%032x" % iteration, files={**files, state.name: files["robot.toml"]})(place)
        labels = {"score": {"value": score, "episodes": 1, "steps": 1, "seed": 0}, "tags": ["t%d" % iteration], **labels}
        (place / "labels.json").write_text(json.dumps(labels))
        return state

    states = {iteration: keep(iteration, score) for iteration, score in ((1, 0.5), (2, 0.2), (12, 0.4))}
    (run / "config.toml").write_text((POLICY / "config.toml").read_text())
    # Training cannot go on from it.
    shutil.copytree(POLICY, run / "checkpoints" / "iteration-00000099")
    for given, expected in (("", 12), (":latest", 12), (":best", 2), (":1", 1), (":t2", 2), (":iteration-00000012", 12)):
        assert load(str(run) + given).path.name == "iteration-%08d" % expected, given
    refused(ValueError, "holds no checkpoint `7`; it has iteration-00000099", load, str(run) + ":7")

    def newest(*damaged):
        """The iteration that `RUN` means, and that newer ones are said to be damaged."""
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            found = load(run).iteration
        assert all("iteration-%08d" % iteration in str(one.message) for iteration, one in zip(damaged, told, strict=True)), told
        return found

    # What the run has not come to itself is not its newest, unless there is no other; what is damaged is passed over.
    keep(50, 0.1, imported=True)
    assert newest() == 12, "it is imported"
    assert load(str(run) + ":best").iteration == 2, "its score is not the run's"
    (run / "metrics.jsonl").write_text("".join('{"iteration": %d, "digest": "%032x"}\n' % (n, n + 1) for n in range(12)))
    keep(60, 0.1, tags=["t2"])
    assert newest() == 12, "nothing is recorded of it"
    assert load(str(run) + ":best").iteration == 2
    refused(ValueError, "the tag `t2` is on iteration-00000002 and on iteration-00000060; tag one of them again", load, str(run) + ":t2")
    states[12].write_bytes(states[12].read_bytes().swapcase())
    assert newest(12) == 2
    states[2].unlink()
    (states[1].parent / "manifest.json").write_text("")
    assert newest(12, 2, 1) == 60
    policy = load(POLICY)
    assert policy.iteration == 188

    two = spaceoctopus.Batch(2, robot=two_arm, set=SHORT)
    two.reset()
    assert two.observation.shape == (2, 4, 62) and two.hand_goal.shape == (2, 2, 6)
    lone = spaceoctopus.Robot.from_toml("[[arms]]".join(spaceoctopus.Robot(two_arm).to_toml().split("[[arms]]")[:2]))
    refused(ValueError, "has 1 arm, and task `mixed` needs 2", spaceoctopus.Batch, 1, task="mixed", robot=lone)

refused(ValueError, "shape (8, 61)", policy.act, np.zeros((8, 61)))
refused(ValueError, "environment 1, agent 0: observation 3 is NaN", policy.act, np.where(np.arange(2 * 8 * 62).reshape(2, 8, 62) == 8 * 62 + 3, np.nan, 0))
refused(TypeError, "real numbers", policy.act, np.zeros((8, 62), complex))
assert policy.act(np.zeros((0, 8, 62))).shape == (0, 8, 3)
seen = np.random.default_rng(1).normal(size=(2, 8, 62)).astype(np.float32)
for observation in (seen, seen[0]):
    assert np.array_equal(policy.act(observation.tolist()), policy.act(observation))
refused(ValueError, "steps is 0", policy.evaluate, 1, 0)
refused(ValueError, "episodes is", policy.evaluate, 10**7)
refused(ValueError, "episodes times steps is", policy.evaluate, 10**6, 10**5)
for wrong in ((-1,), (1, -1), (1 << 64,)):
    refused(ValueError, "is out of range", policy.evaluate, *wrong)
refused(ValueError, "-1 is out of range", policy.evaluate, 1, 1, seed=-1)
for wrong in ((-1, 2), (1 << 32, 2), (0, -1)):
    refused(ValueError, "is out of range", policy.play, *wrong)
refused(ValueError, "hand_goal has shape (3,), expected (4, 6)", policy.play, 0, 1, hand_goal=[1, 2, 3])
refused(ValueError, "hand_goal has shape (6, 4), expected (4, 6)", policy.play, 0, 1, hand_goal=np.zeros((6, 4)))
refused(ValueError, "hand_goal[2] holds inf", policy.play, 0, 1, hand_goal=np.where(np.arange(24).reshape(4, 6) == 13, np.inf, 0))
refused(ValueError, "base_goal has shape (2,), expected (3,)", policy.play, 0, 1, base_goal=[1, 2])
refused(ValueError, "base_goal has no meaning here: the policy learned `trajectory`", policy.play, 0, 1, base_goal=[0.1, 0, 0])
turning = load(ROOT / "deploy" / "policies" / "reorientation")
one_row = np.where(np.arange(24).reshape(4, 6) // 6 == 2, 0.1, np.nan)
refused(ValueError, "hand_goal[2] has no meaning here: the policy learned `reorientation`", turning.play, 0, 1, hand_goal=one_row)
assert turning.play(0, 1, base_goal=[np.nan] * 3)["base_error"].tolist() == turning.play(0, 1)["base_error"].tolist(), "NaN keeps it"
assert turning.play(0, 1, base_goal=[0.1, 0, 0], hand_goal=np.full((4, 6), np.nan))["base_error"].shape == (1, 3)
postures, twin = spaceoctopus.Postures("guided"), spaceoctopus.Postures("guided")
known = [np.zeros(3), np.array([1, 0, 0, 0]), np.zeros((4, 6)), np.full((4, 6), 0.1)]
assert np.array_equal(postures.update(*known), twin.update(*known))
for index, what in enumerate(("base_position", "base_attitude", "joint_angles", "goals")):
    for number in (1e20, 1.1e6, -1e300, np.nan):
        wrong = [given.astype(float) for given in known]
        wrong[index].flat[0] = number
        refused(ValueError, what + " has the number", postures.update, *wrong)
assert np.array_equal(postures.update(*known), twin.update(*known)), "what was refused changed something"
refused(ValueError, "expected [steps, 24]", spaceoctopus.simulate, np.zeros((5, 23)))
refused(ValueError, "step 3, joint 4: the action is NaN", spaceoctopus.simulate, np.where(np.arange(120).reshape(5, 24) == 76, np.nan, 0))
refused(ValueError, "does not divide", spaceoctopus.simulate, np.zeros((5, 24)), substep=0.3)
refused(ValueError, "control_period", spaceoctopus.simulate, np.zeros((5, 24)), control_period=np.nan)
refused(ValueError, "integrator", spaceoctopus.simulate, np.zeros((5, 24)), integrator="rk5")
assert spaceoctopus.simulate(np.zeros((0, 24)))["hands"].shape == (0, 4, 3)


# --- threads ----------------------------------------------------------------------------------------------------
def course(made, seed):
    """Everything that a batch pays and shows over an episode."""
    made.reset(seed)
    noise, said = np.random.default_rng(seed), []
    while not made.truncated[0]:
        made.step(noise.uniform(-1, 1, (made.n_envs, 8, 3)))
        said.append((made.reward.copy(), made.observation.copy()))
    return said


def same(a, b):
    return len(a) == len(b) and all(np.array_equal(x, y) for row, other in zip(a, b) for x, y in zip(row, other))


expected = {seed: course(batch(40), seed) for seed in (1, 2, 3)}
found = {}
together = [threading.Thread(target=lambda seed=seed: found.update({seed: course(batch(40), seed)})) for seed in expected]
[thread.start() for thread in together]
[thread.join() for thread in together]
assert all(same(expected[seed], found[seed]) for seed in expected), "batches beside each other do not mix"

# One batch in two hands: one of them is told so, and the batch is whole. Steps are to be long, not resets: it does without goal
# postures, whose search is 50 times a step.
LARGE = 6000
large = spaceoctopus.Batch(LARGE, set=[*SHORT, "task.posture.seen=false", "task.posture.gain=0"], threads=2)
rest = np.zeros((LARGE, 8, 3), np.float32)
large.reset(1)
told, ticks, done = [], 0, threading.Event()


def tick():
    global ticks
    while not done.is_set():
        ticks += 1
        time.sleep(0.001)


def hand():
    try:
        large.step(rest)
    except RuntimeError as error:
        told.append(str(error))


thread = threading.Thread(target=tick)
thread.start()
most = 0
for _ in range(9):
    before = ticks
    large.step(rest)
    most = max(most, ticks - before)
assert most > 3, "Python goes on while a step is made"
deadline = time.monotonic() + 60
while not any("another thread" in words for words in told) and time.monotonic() < deadline:
    large.reset(1)
    hands = [threading.Thread(target=hand) for _ in range(4)]
    [thread_of_hand.start() for thread_of_hand in hands]
    [thread_of_hand.join() for thread_of_hand in hands]
    assert large.steps >= 1, "the batch is whole"
done.set()
thread.join()
assert set(told) == {"the batch is being stepped by another thread"}, set(told)
large.reset(1)
reference = large.observation.copy()

# --- interrupts in the middle of a long step --------------------------------------------------------------------
middle = 0
for _ in range(20):
    large.reset(1)
    timer = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            if large.truncated[0]:
                large.reset(1)
            large.step(rest)
        raise AssertionError("no interrupt came")
    except KeyboardInterrupt:
        timer.join()
    if large.steps is None:
        middle += 1
        refused(RuntimeError, "reset first", large.step, rest)
        large.reset(1)
        assert np.array_equal(large.observation, reference)
        if middle == 2:
            break
assert middle == 2, "a step is left in its middle"
timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
timer.start()
refused(KeyboardInterrupt, "", lambda: [policy.evaluate(400, 200) for _ in range(1000)])
timer.join()
timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
timer.start()
refused(KeyboardInterrupt, "", spaceoctopus.simulate, np.zeros((1_000_000, 24), np.float32))
timer.join()

# --- forks ------------------------------------------------------------------------------------------------------
warnings.filterwarnings("ignore", category=DeprecationWarning, message=".*multi-threaded.*")


def in_child(work):
    """Whether `work` comes true in a forked process."""
    child = os.fork()
    if child == 0:
        try:
            os._exit(0 if work() else 1)
        except BaseException as error:
            os.write(2, repr(error).encode())
            os._exit(2)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    raise AssertionError("the child hangs")


shared = batch(40, threads=2)
course(shared, 2)
assert in_child(lambda: same(course(shared, 1), expected[1])), "a child goes on with what it inherits"
assert same(course(shared, 3), expected[3]), "and its parent, too"
assert in_child(lambda: same(course(batch(40), 2), expected[2])), "a child makes its own"


def without_threads():
    """A course where the system gives no thread; one of a common person, as it refuses root none."""
    if os.geteuid() == 0:
        os.setuid(65534)
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
    try:
        threading.Thread(target=int).start()
    except RuntimeError:
        pass
    else:
        raise AssertionError("the system gives threads all the same")
    return same(course(batch(40, threads=4), 1), expected[1])


assert in_child(without_threads), "a step is made with the threads that there are"


def busy_in_the_parent():
    try:
        large.step(rest)
    except RuntimeError as error:
        return "another thread" in str(error)
    return False


large.reset(1)
thread = threading.Thread(target=lambda: [large.step(rest) for _ in range(8)])
thread.start()
while True:
    try:
        large.closed
    except RuntimeError:
        break
    assert thread.is_alive()
# A step that was going on when the process forked never ends in the child, which is told so instead of waiting.
inherited = in_child(busy_in_the_parent)
thread.join()
assert inherited, "a child that inherits a step does not wait for it"
