"""Holds controller.onnx and policy.onnx against vectors.json, with ONNX Runtime.

    pip install numpy onnxruntime
    python check.py            # or: python check.py DIRECTORY

Says the largest differences, and exits with 1 if one is larger than vectors.json allows.
"""

import json
import pathlib
import sys

import numpy as np
import onnxruntime

folder = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else pathlib.Path(__file__).parent
vectors = json.loads((folder / "vectors.json").read_text())
cases = vectors["cases"]
tolerance = vectors["onnx_tolerance"]


def column(name):
    return np.array([case[name] for case in cases], np.float32)


controller = onnxruntime.InferenceSession(folder / "controller.onnx", providers=["CPUExecutionProvider"])
policy = onnxruntime.InferenceSession(folder / "policy.onnx", providers=["CPUExecutionProvider"])
feeds = {}
for port in controller.get_inputs():
    # Goals of one kind alone are called just that.
    name = port.name if port.name in cases[0] else "goals"
    feeds[port.name] = column(name).reshape(len(cases), *port.shape[1:])
(command,) = controller.run(None, feeds)
(actions,) = policy.run(None, {"observations": column("observations")})
scale = float(controller.get_modelmeta().custom_metadata_map["action_scale"])
off = np.abs(command - column("command")).max()
off_policy = np.abs(scale * actions - column("command")).max()
# One robot alone is commanded as beside others, but for the order of sums.
alone = np.concatenate([controller.run(None, {key: value[i : i + 1] for key, value in feeds.items()})[0] for i in range(8)])
off_alone = np.abs(alone - command[:8]).max()
print(
    f"{len(cases)} states: controller.onnx off by {off:.2g} rad/s at most, policy.onnx by {off_policy:.2g}, "
    f"one robot at a time by {off_alone:.2g}; {tolerance:.2g} is allowed"
)
# Each by itself: what is no number is larger than none.
sys.exit(not (len(cases) > 0 and all(each <= tolerance for each in (off, off_policy, off_alone))))
