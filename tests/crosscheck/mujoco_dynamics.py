"""MuJoCo's answers about a robot that SpaceOctopus exported.

    mujoco_dynamics.py INPUT.json OUTPUT.json

INPUT: {"model": MJCF text, "joints": [names in our order], "hands": [site names],
        "states": [{"qpos", "qvel", "tau"}],          inertia matrix and acceleration wanted
        "episode": {"qpos", "commands": [[...]], "steps_per_command",    integrated with MuJoCo's own Euler at the model's time step
                    "disturbances": [{"hand_force": [[x, y, z]], "base_torque", "joint_torque", "limp": [actuators]}]},   one a command
        "keyframe": name,                             positions there, and where that puts the hands
        "touching": {"model": MJCF text with contacts, "poses": [[joint angles]], "stops": [...]}}   pairs in contact wanted
Every part may be absent.
"""

import json
import sys

import mujoco
import numpy as np


def accelerations(model, states):
    """Inertia matrix and generalised acceleration under given joint torques, servos off."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data = mujoco.MjData(model)
    out = []
    for state in states:
        data.qpos[:] = state["qpos"]
        data.qvel[:] = state["qvel"]
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[6:] = state["tau"]
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        out.append({"inertia": full.ravel().tolist(), "qacc": data.qacc.tolist()})
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)
    return out


def disturb(model, data, sites, disturbance):
    """Puts forces on the hands and torques on base and joints, as the bodies stand now."""
    # mj_step reads forces before it places the bodies.
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    data.qfrc_applied[:] = 0.0
    none = np.zeros(3)
    for site, force in zip(sites, disturbance["hand_force"]):
        body = model.site_bodyid[site]
        mujoco.mj_applyFT(model, data, np.array(force), none, data.site_xpos[site], body, data.qfrc_applied)
    base = model.body("base").id
    torque = np.array(disturbance["base_torque"])
    mujoco.mj_applyFT(model, data, none, torque, data.xpos[base], base, data.qfrc_applied)
    data.qfrc_applied[6:] += disturbance["joint_torque"]


def episode(model, hands, part):
    """States and hands after every command, by semi-implicit Euler without implicit damping."""
    disturbances = part.get("disturbances")
    gain, bias = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    data = mujoco.MjData(model)
    data.qpos[:] = part["qpos"]
    sites = [model.site(name).id for name in hands]
    out = []
    for index, command in enumerate(part["commands"]):
        data.ctrl[:] = command
        if disturbances:
            model.actuator_gainprm[:], model.actuator_biasprm[:] = gain, bias
            limp = disturbances[index]["limp"]
            model.actuator_gainprm[limp], model.actuator_biasprm[limp] = 0.0, 0.0
        for _ in range(part["steps_per_command"]):
            if disturbances:
                disturb(model, data, sites, disturbances[index])
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        out.append(
            {
                "qpos": data.qpos.tolist(),
                "qvel": data.qvel.tolist(),
                "hands": data.site_xpos[sites].ravel().tolist(),
            }
        )
    return out


def part_of(model, geom):
    """The thing a shape belongs to: a link's body, or a box or pedestal of the base (which is one body to MuJoCo)."""
    name = model.geom(geom).name
    body = model.body(model.geom_bodyid[geom]).name
    if body != "base":
        return body
    return name.rsplit("_", 1)[0] if "_pedestal_" in name else name


def touching(part):
    """Number of pairs of parts in contact, those told by joint angle by their formulas."""
    model = mujoco.MjModel.from_xml_string(part["model"])
    data = mujoco.MjData(model)
    parts = [part_of(model, geom) for geom in range(model.ngeom)]
    arms, stops = part["arms"], part["stops"]
    by_angle = {frozenset((f"{arm}_{a}", f"{arm}_{b}")) for arm in arms for a, b in (s["pair"] for s in stops)}
    out = []
    for pose in part["poses"]:
        data.qpos[3] = 1.0
        data.qpos[7:] = pose
        mujoco.mj_forward(model, data)
        pairs = set()
        for contact in data.contact:
            pair = frozenset(parts[g] for g in contact.geom)
            if contact.dist < 0.0 and len(pair) == 2 and pair not in by_angle:
                pairs.add(pair)
        angles = 0
        for arm in range(len(arms)):
            q = np.asarray(pose[6 * arm : 6 * arm + 6])
            for stop in stops:
                lo, hi = stop["interval"]
                narrow = stop["narrowing"] * abs(np.sin(2.0 * q[stop["narrowing_joint"] - 1]))
                offset = np.remainder(q[stop["joint"] - 1] - lo - narrow, 2.0 * np.pi)
                angles += offset <= hi - lo - 2.0 * narrow
        out.append(len(pairs) + int(angles))
    return out


def main():
    given = json.load(open(sys.argv[1], encoding="utf-8"))
    model = mujoco.MjModel.from_xml_string(given["model"])
    answer = {"version": mujoco.__version__, "mass": float(model.body_mass.sum())}
    answer["joints"] = [model.joint(j).name for j in range(1, model.njnt)]
    if "states" in given:
        answer["states"] = accelerations(model, given["states"])
    if "episode" in given:
        answer["episode"] = episode(model, given["hands"], given["episode"])
    if "keyframe" in given:
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key(given["keyframe"]).id)
        mujoco.mj_forward(model, data)
        sites = [model.site(name).id for name in given["hands"]]
        answer["keyframe"] = {"qpos": data.qpos.tolist(), "hands": data.site_xpos[sites].ravel().tolist()}
    if "touching" in given:
        answer["touching"] = touching(given["touching"])
    json.dump(answer, open(sys.argv[2], "w", encoding="utf-8"))


if __name__ == "__main__":
    main()
