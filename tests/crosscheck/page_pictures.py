"""The guide's pictures of the page.

    page_pictures.py CHROMIUM FILE.html ADDRESS FOLDER  `octopus view deploy/policies/trajectory --with deploy/policies/reorientation --out FILE.html`;
                                                        ADDRESS is that of a run that trains and has kept some checkpoints

Writes page-robot.webp, -goal, -push, -phone and -run, for deploy/pictures.
"""

import io
import os
import sys
import time

from PIL import Image

from page import browser
from page_hold import Held
from page_run import RunPage, death

WIDE = {"width": 1360, "height": 850}


def keep(page, folder, name):
    picture = Image.open(io.BytesIO(page.tab.screenshot())).convert("RGB")
    for quality in (90, 84, 78, 70, 60):
        out = io.BytesIO()
        picture.save(out, "WEBP", quality=quality, method=6)
        if out.tell() < 120_000:
            break
    with open(os.path.join(folder, "page-%s.webp" % name), "wb") as file:
        file.write(out.getvalue())
    print(name, picture.size, out.tell(), flush=True)


def paused(opened, path, step, **context):
    """The page of the file, at a control step of its episode."""
    page = Held(opened.new_context(**{"viewport": WIDE, **context}), "file://" + path)
    page.ready()
    page.wait("timeline.head >= %d" % step)
    page.pause()
    page.room("timeline.seek(%d)" % step)
    return page


def robot(opened, path, folder):
    """The robot on its way, in a form that is not square."""
    page = paused(opened, path, 22)
    time.sleep(1)
    keep(page, folder, "robot")


def handles(opened, path, folder):
    """A goal that is turned, in the dark."""
    page = paused(opened, path, 70, color_scheme="dark")
    page.press("2")
    page.press("r")
    page.turn("1", 60)
    page.run(5)
    page.moved_by(3, "limp")
    ring = page.ring("1")
    page.tab.mouse.move(ring["x"], ring["y"])
    time.sleep(1)
    keep(page, folder, "goal")


def push(opened, path, folder):
    """A base that is pulled, seen from nearer."""
    page = paused(opened, path, 40)
    x, y = page.on_screen(page.now("bodies")[12:15])
    mouse = page.tab.mouse
    mouse.move(x, y - 20)
    mouse.down()
    mouse.move(x + 60, y - 30)
    mouse.move(x + 230, y - 70)
    time.sleep(0.5)
    keep(page, folder, "push")
    mouse.up()


def phone(opened, path, folder):
    page = paused(opened, path, 28, viewport={"width": 390, "height": 844}, device_scale_factor=1.5, is_mobile=True, has_touch=True)
    time.sleep(1)
    keep(page, folder, "phone")


def run(opened, address, folder):
    """A run that trains, with a worker that has died."""
    page = RunPage(opened.new_context(viewport={"width": 1360, "height": 980}), address.replace("#", "#run=1&"))
    page.ready()
    page.hears("f.metrics.lines.length > 12 && f.checkpoints.length > 2")
    death(page)
    page.tab.wait_for_selector(".notice", state="detached")
    time.sleep(4)
    keep(page, folder, "run")


def main():
    chromium, path, address, folder = sys.argv[1:]
    with browser(chromium) as opened:
        for picture in (robot, handles, push, phone):
            picture(opened, path, folder)
        run(opened, address, folder)


if __name__ == "__main__":
    main()
