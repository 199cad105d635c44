"""Exported controllers in ONNX Runtime: controllers.py check DIR..., or controllers.py loop ROBOTS DIR.

`check` has ONNX's own checker look at both models of each directory, and runs the directory's check.py.
`loop` answers a simulator: for each step a line a robot with what the inputs are, one after the other; out go the commands.
"""

import pathlib
import runpy
import sys
import tomllib

import numpy as np
import onnx
import onnxruntime


def check(folder):
    contract = tomllib.loads((folder / "contract.toml").read_text())
    of_controller = [port["name"] for port in contract["input"]]
    for name, inputs in ("controller.onnx", of_controller), ("policy.onnx", ["observations"]):
        onnx.checker.check_model(folder / name, full_check=True)
        model = onnx.load(folder / name)
        assert [port.name for port in model.graph.input] == inputs, name
        assert len(model.graph.output) == 1, name
        for port in [*model.graph.input, *model.graph.output]:
            assert port.type.tensor_type.shape.dim[0].dim_param == "batch", (name, port.name)
        about = {entry.key: entry.value for entry in model.metadata_props}
        joints = model.graph.output[0].type.tensor_type.shape.dim[1].dim_value
        assert len(about["joint_names"].split(",")) == joints, about
        assert about["task"] == contract["controller"]["task"] and about["robot"] and about["digest"], about
        assert float(about["control_period_s"]) > 0 and about["units"] == "m, rad, s", about
        for tensor in model.graph.initializer:
            # Every row of a tensor of all actors is another one.
            if tensor.name.startswith(("hidden", "head", "input")):
                values = onnx.numpy_helper.to_array(tensor)
                rows = {row.tobytes() for row in values}
                assert len(rows) == len(values), tensor.name
    sys.argv = ["check.py", str(folder)]
    try:
        runpy.run_path(str(folder / "check.py"), run_name="__main__")
    except SystemExit as end:
        assert not end.code, f"{folder}: check.py ends with {end.code}"


def loop(robots, folder):
    session = onnxruntime.InferenceSession(folder / "controller.onnx", providers=["CPUExecutionProvider"])
    ports = session.get_inputs()
    sizes = [int(np.prod(port.shape[1:])) for port in ports]
    while True:
        lines = [sys.stdin.readline() for _ in range(robots)]
        if not lines[-1]:
            return
        values = np.array([line.split() for line in lines], np.float32)
        parts = np.split(values, np.cumsum(sizes)[:-1], axis=1)
        feeds = {port.name: part.reshape(robots, *port.shape[1:]) for port, part in zip(ports, parts)}
        (commands,) = session.run(None, feeds)
        for row in commands:
            print(*(repr(float(x)) for x in row))
        sys.stdout.flush()


if sys.argv[1] == "check":
    for folder in [pathlib.Path(name) for name in sys.argv[2:]]:
        check(folder)
else:
    loop(int(sys.argv[2]), pathlib.Path(sys.argv[3]))
