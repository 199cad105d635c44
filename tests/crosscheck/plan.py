#!/usr/bin/env python3
"""Plays a table of joint rate commands on an exported model in MuJoCo:  plan.py MODEL.xml HOME.json COMMANDS.csv

HOME.json holds qpos. Prints where each hand ends, as JSON: position (m) and quaternion (w, x, y, z) in the world, and the most
contacts that were seen after a control step.
"""

import csv
import json
import sys

import mujoco
import numpy

CONTROL_PERIOD = 0.4


def main():
    model_path, home_path, commands_path = sys.argv[1:]
    model = mujoco.MjModel.from_xml_path(model_path)
    data = mujoco.MjData(model)
    with open(home_path) as file:
        data.qpos[:] = json.load(file)
    with open(commands_path) as file:
        commands = [[float(cell) for cell in row] for row in csv.reader(file)]
    steps = round(CONTROL_PERIOD / model.opt.timestep)
    contacts = 0
    for row in commands:
        data.ctrl[:] = row
        mujoco.mj_step(model, data, steps)
        contacts = max(contacts, data.ncon)
    mujoco.mj_forward(model, data)
    hands = []
    for site in range(model.nsite):
        quaternion = numpy.empty(4)
        mujoco.mju_mat2Quat(quaternion, data.site_xmat[site])
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SITE, site)
        hands.append({"name": name, "position": data.site_xpos[site].tolist(), "quaternion": quaternion.tolist()})
    print(json.dumps({"hands": hands, "contacts": int(contacts)}))


main()
