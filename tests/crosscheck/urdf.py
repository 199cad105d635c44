"""How far a robot that was made of a URDF is from what MuJoCo reads in the same URDF.

    urdf.py ROBOT.urdf ROBOT.xml ROBOT.toml SEED

ROBOT.xml is `octopus mjcf` of ROBOT.toml, which is `octopus robot import` of ROBOT.urdf. MuJoCo holds the base of a URDF, so all is
compared with the base held: joint-space inertia, and where the masses are. Prints {"inertia": relative, "masses": m, "joints": n}, the
largest differences over ten random poses.
"""

import json
import sys
import tomllib

import mujoco
import numpy as np

POSES = 10


def main():
    urdf, mjcf, description, seed = sys.argv[1:]
    theirs = mujoco.MjModel.from_xml_path(urdf)
    ours = mujoco.MjModel.from_xml_path(mjcf)
    # Of drives the URDF says nothing.
    ours.dof_armature[:] = 0.0
    with open(description, "rb") as file:
        arms = tomllib.load(file)["arms"]
    # The URDF's zero is home. Arms stand in the order in which the URDF has them, joints in that of the chain.
    home = np.concatenate([arm["home"] for arm in arms])
    assert theirs.nv == len(home) == ours.nv - 6, (theirs.nv, len(home), ours.nv)
    rng = np.random.default_rng(int(seed))
    worst = {"inertia": 0.0, "masses": 0.0}
    for _ in range(POSES):
        q = rng.uniform(-3, 3, theirs.nv)
        inertias, centres = [], []
        for model, first, angles in ((theirs, 0, q), (ours, 6, q + home)):
            data = mujoco.MjData(model)
            data.qpos[-len(q) :] = angles
            if first:
                data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
            mujoco.mj_forward(model, data)
            full = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, full)
            inertias.append(full[first:, first:])
            moving = [model.jnt_bodyid[j] for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE]
            centres.append(data.xipos[moving])
        worst["inertia"] = max(worst["inertia"], np.abs(inertias[0] - inertias[1]).max() / np.abs(inertias[0]).max())
        worst["masses"] = max(worst["masses"], np.abs(centres[0] - centres[1]).max())
    print(json.dumps({**worst, "joints": theirs.nv}))


main()
