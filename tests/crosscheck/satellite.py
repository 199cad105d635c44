"""Puts arms of other people on a base of ours: satellite.py OUT.urdf ROBOT.urdf:LINK ROBOT.urdf:LINK …

ROBOT.urdf is a file of the package example-robot-data, below its folder `robots`. LINK is where the arm begins: what it carries comes along, what carries it does
not. Arms stand on the sides of a cube of 400 kg. Fingers, which slide, are held; meshes are left out, as importing leaves them out; what only MuJoCo
would not read (materials, transmissions) is left out, too.
"""

import copy
import pathlib
import sys
import xml.etree.ElementTree as xml

# Where arms stand on the cube, and how they are turned (m, rad).
PLACES = [("0 0.44 0", "-1.5707963 0 0"), ("0 -0.44 0", "1.5707963 0 0"), ("0 0 0.44", "0 0 0.4"), ("0 0 -0.44", "3.1415926 0 0.2")]


def robots():
    """The package's folder of robots."""
    for place in map(pathlib.Path, sys.path):
        found = place / "cmeel.prefix/share/example-robot-data/robots"
        if found.is_dir():
            return found
    sys.exit("example-robot-data is not installed")


def below(tree, first):
    """Names of the links from `first` on, and the joints between them."""
    links, joints, waiting = [], [], [first]
    while waiting:
        link = waiting.pop()
        links.append(link)
        for joint in tree.findall("joint"):
            if joint.find("parent").get("link") == link:
                joints.append(joint)
                waiting.append(joint.find("child").get("link"))
    return links, joints


def simplified(link):
    for shape in [*link.findall("visual"), *link.findall("collision")]:
        if shape.tag == "visual" or shape.find("geometry/mesh") is not None:
            link.remove(shape)
    # A mass of zero is none. MuJoCo would weigh what has no mass by its shapes.
    inertial = link.find("inertial")
    if inertial is not None and float(inertial.find("mass").get("value")) == 0:
        link.remove(inertial)
        inertial = None
    for shape in link.findall("collision") if inertial is None else []:
        link.remove(shape)
    return link


def main():
    out, *arms = sys.argv[1:]
    robot = xml.Element("robot", name="satellite")
    base = xml.SubElement(robot, "link", name="base")
    inertial = xml.SubElement(base, "inertial")
    xml.SubElement(inertial, "mass", value="400")
    xml.SubElement(inertial, "inertia", ixx="50", iyy="50", izz="50", ixy="0", ixz="0", iyz="0")
    for number, (arm, (xyz, rpy)) in enumerate(zip(arms, PLACES)):
        file, first = arm.split(":")
        tree = xml.parse(robots() / file).getroot()
        links, joints = below(tree, first)
        name = lambda of: "arm%d_%s" % (number, of)
        mount = xml.SubElement(robot, "joint", name=name("mount"), type="fixed")
        xml.SubElement(mount, "origin", xyz=xyz, rpy=rpy)
        xml.SubElement(mount, "parent", link="base")
        xml.SubElement(mount, "child", link=name(first))
        for link in tree.findall("link"):
            if link.get("name") in links:
                link = simplified(copy.deepcopy(link))
                link.set("name", name(link.get("name")))
                robot.append(link)
        for joint in joints:
            joint = copy.deepcopy(joint)
            for gone in ["mimic", "safety_controller", "calibration", "dynamics"]:
                for part in joint.findall(gone):
                    joint.remove(part)
            if joint.get("type") == "prismatic":
                joint.set("type", "fixed")
            joint.set("name", name(joint.get("name")))
            for end in ["parent", "child"]:
                joint.find(end).set("link", name(joint.find(end).get("link")))
            robot.append(joint)
    xml.ElementTree(robot).write(out)


main()
