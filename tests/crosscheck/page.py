"""The page in a real browser.

    page.py CHROMIUM file FILE.html                     the one file, without a network
    page.py CHROMIUM served ADDRESS                     the page of a service, at the address that holds its token
    page.py CHROMIUM replayed ADDRESS|FILE.html         the page of an episode

Prints what was found as JSON; exit status 1 and a sentence where something is not as it should be.
"""

import http.server
import json
import sys
import threading
import time
import urllib.error
import urllib.request
from contextlib import contextmanager

from playwright.sync_api import sync_playwright

DRAWING = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WAIT = 240_000  # ms; a machine may be busy


def check(holds, sentence):
    if not holds:
        raise SystemExit(sentence)


class Page:
    """A tab, its complaints, and what the page knows."""

    def __init__(self, context, address):
        self.tab = context.new_page()
        self.tab.set_default_timeout(WAIT)
        self.errors = []
        self.tab.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.goto(address)

    def ready(self):
        self.tab.wait_for_selector("body[data-ready]")
        return int(self.tab.evaluate("document.body.dataset.ready"))

    def room(self, expression):
        return self.tab.evaluate("(() => { const room = spaceoctopus, timeline = room.timeline; return (%s); })()" % expression)

    def wait(self, expression):
        self.until(lambda: self.room(expression), expression)

    def until(self, holds, expression):
        # Playwright's own way evaluates text in the page, which the page forbids.
        end = time.monotonic() + WAIT / 1000
        while not holds():
            check(time.monotonic() < end, "never came: %s; the console: %s" % (expression, self.errors))
            time.sleep(0.05)

    def press(self, key):
        self.tab.keyboard.press(key)

    def state(self, step):
        """Bits of all numbers of the robot's state."""
        return self.room("[...new Uint32Array(timeline.frames[%d].state.slice().buffer)]" % step)

    def on_screen(self, position):
        """Where a point of the world is drawn."""
        return self.room(
            """(() => { const canvas = room.view.stage.renderer.domElement.getBoundingClientRect();
            const p = room.view.stage.orbit.target.clone().set(%s).project(room.view.stage.camera);
            return [canvas.left + (p.x + 1) / 2 * canvas.width, canvas.top + (1 - p.y) / 2 * canvas.height]; })()"""
            % ", ".join(str(x) for x in position)
        )

    def quiet(self):
        check(not self.errors, "the console has errors: %s" % self.errors)


@contextmanager
def browser(chromium):
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=chromium, args=DRAWING)
        try:
            yield opened
        finally:
            opened.close()


def drawn(page):
    """How many pixels of the scene are not background, and how many colours there are."""
    return page.room(
        """(() => { room.view.draw(0); const gl = room.view.stage.renderer.getContext();
        const [w, h] = [gl.drawingBufferWidth, gl.drawingBufferHeight], bytes = new Uint8Array(4 * w * h);
        gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
        const corner = String(bytes.slice(4 * (w * h - 1) , 4 * (w * h - 1) + 3)), seen = new Set(); let other = 0;
        for (let i = 0; i < bytes.length; i += 4) { const c = String(bytes.slice(i, i + 3)); seen.add(c); if (c !== corner) other++; }
        return { share: other / (w * h), colours: seen.size }; })()"""
    )


def episode(page):
    """Play, pause, step and back; what is seen twice is the same to the bit."""
    page.wait("timeline.head >= 6")
    page.press("Space")
    page.wait("!timeline.playing")
    at = page.room("timeline.cursor")
    check(at == int(at), "a pause is between two control steps: %s" % at)
    at = int(at)
    page.press("ArrowRight")
    page.wait("timeline.cursor === %d" % (at + 1))
    first = [page.state(step) for step in range(at + 2)]
    page.press("ArrowLeft")
    page.press("ArrowLeft")
    page.wait("timeline.cursor === %d" % (at - 1))
    check(page.state(at - 1) == first[at - 1], "a step back shows other numbers")
    # Forgotten, and simulated anew from what is kept of the step before.
    page.room("timeline.cutAt(%d)" % (at - 1))
    check(page.room("timeline.head") == at - 1, "what was cut off is still there")
    page.press("ArrowRight")
    page.wait("timeline.cursor === %d" % at)
    page.press("ArrowRight")
    page.wait("timeline.cursor === %d" % (at + 1))
    check([page.state(step) for step in range(at + 2)] == first, "the same steps give other numbers")


def drag_goal(page):
    """A goal that is dragged is where the hand goes."""
    page.press("1")
    page.wait("room.view.goals.selected === 0")
    goal = page.room("[...timeline.frames[timeline.head].hand_goals.slice(0, 3)]")
    mouse = page.tab.mouse
    # The handle that points up is somewhere above the goal; how long it is depends on the view.
    for tenths in range(1, 30):
        x, y = page.on_screen([goal[0], goal[1], goal[2] + 0.01 * tenths])
        mouse.move(x, y)
        if page.room("room.view.goals.axis") == "Z":
            break
    check(page.room("room.view.goals.axis") == "Z", "the goal has no handle that points up")
    mouse.down()
    for part in range(1, 6):
        mouse.move(x, y - 4 * part)
    mouse.up()
    page.wait("timeline.events.some(({ event }) => event.hand_goal !== undefined)")
    page.wait("Math.hypot(...[0, 1, 2].map((i) => timeline.frames[timeline.head].hand_goals[i] - [%s][i])) > 0.02" % ", ".join(map(str, goal)))
    page.press("Escape")
    mouse.move(5, 5)
    page.room("timeline.speed = 16")
    begin = page.room("timeline.head")
    page.press("Space")
    page.wait("timeline.head >= %d" % (begin + 100))
    page.press("Space")
    page.wait("!timeline.playing")
    error = page.room("timeline.frames[%d].position_error[0]" % (begin + 100))
    check(error < 0.010, "the hand is %.1f mm from the goal that was dragged" % (1000 * error))
    return error


def push_base(page):
    """A body that is pulled moves, and the arrow says how strongly."""
    box = page.tab.locator(".scene canvas").bounding_box()
    x, y = page.on_screen(page.room("[...timeline.frames[Math.floor(timeline.cursor)].bodies.slice(12, 15)]"))
    check(box["x"] < x < box["x"] + box["width"], "the base is not on the screen")
    mouse = page.tab.mouse
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + 40, y + 5)
    mouse.move(x + 90, y + 10)
    page.tab.wait_for_selector(".force", state="visible")
    words = page.tab.inner_text(".force")
    page.press("ArrowRight")
    page.wait("timeline.events.some(({ event }) => event.effect !== undefined)")
    mouse.up()
    page.tab.wait_for_selector(".force", state="hidden")
    newtons = page.room("Math.hypot(...timeline.events.find(({ event }) => event.effect !== undefined).event.effect.effect.wrench.force)")
    check(words == "%.0f N" % newtons, "the arrow says %s, the force is %s N" % (words, newtons))
    return newtons


def play_again(context, page, address):
    """What was done becomes a link that plays the same again."""
    steps = page.room("timeline.head")
    fragment = page.tab.evaluate("spaceoctopus.fragment()")
    # Another tab has no token of its own.
    token = [part for part in address.partition("#")[2].split("&") if part.startswith("token=")]
    again = Page(context, "%s#%s" % (address.split("#")[0], "&".join([fragment, *token])))
    again.ready()
    again.wait("timeline.head >= %d" % steps)
    for step in range(steps + 1):
        check(again.state(step) == page.state(step), "the link gives other numbers in control step %d" % step)
    again.quiet()
    again.tab.close()
    return steps


def play(context, address):
    page = Page(context, address)
    found = {"ready_ms": page.ready()}
    picture = drawn(page)
    check(picture["share"] > 0.05 and picture["colours"] > 200, "the robot is not drawn: %s" % picture)
    found["picture"] = picture
    episode(page)
    # In this order: what was pushed drifts away for ever, and takes the hands along.
    found["goal_error_m"] = drag_goal(page)
    found["newtons"] = push_base(page)
    found["replayed_steps"] = play_again(context, page, address)
    links(context, page, address)
    own_mass(page)
    begun_anew(page)
    found["frames_per_s"] = page.tab.evaluate("Number(document.querySelector('.robot-room').dataset.framesPerSecond)")
    found["step_ms"] = page.tab.evaluate("Number(document.querySelector('.robot-room').dataset.stepMs)")
    page.quiet()
    return found


def links(context, page, address):
    """A link that is pasted where the page is open is played; one that is damaged is said, and keeps nothing from going on."""
    base, _, rest = address.partition("#")
    token = [part for part in rest.split("&") if part.startswith("token=")]
    fragment = page.tab.evaluate("spaceoctopus.fragment()")
    steps, events = page.room("timeline.head"), page.room("timeline.events.length")
    damaged = fragment[: len(fragment) // 2]
    again = Page(context, "%s#%s" % (base, "&".join([damaged, *token])))
    again.tab.wait_for_selector(".notice.error:has-text('this link is damaged')")
    again.ready()
    again.wait("timeline.head >= 3 && timeline.cursor > 1")
    check(again.room("timeline.events.length") == 0, "a damaged link does something")

    again.tab.evaluate("(fragment) => { location.hash = fragment; }", fragment)
    again.wait("timeline.head >= %d && timeline.events.length === %d" % (steps, events))
    check(again.state(steps) == page.state(steps), "a link that is pasted gives other numbers")

    again.tab.evaluate("(fragment) => { location.hash = fragment; }", damaged)
    again.tab.wait_for_selector(".notice.error:has-text('this link is damaged')")
    check(again.room("timeline.events.length") == events, "a damaged link ends what plays")
    files(again)
    # What the simulator refuses ends in an episode that goes on.
    wrong = {"policies": [], "script": {"start": {}, "steps": 4, "events": [{"step": 2, "event": {"arm": {"arm": 9, "control": "hold"}}}]}}
    check(again.tab.evaluate("(recording) => spaceoctopus.replay(recording)", wrong) is False, "an arm too many is played")
    again.wait("timeline.events.length === 0")
    again.room("timeline.play(true)")
    again.wait("timeline.head >= 6")
    cameras = again.tab.locator("select[aria-label='The camera follows'] option").count()
    check(cameras == again.room("timeline.description.n_arms") + 2, "the camera has %d choices" % cameras)
    again.quiet()
    again.tab.close()


def files(page):
    """What the command line reads the page plays; what it cannot play it says."""
    open_file = lambda script: page.tab.set_input_files(
        "input[type=file]", {"name": "episode.json", "mimeType": "application/json", "buffer": json.dumps(script).encode()}
    )
    noise = {"position": 0.001, "angle": 0.001, "velocity": 0.0, "rate": 0.0}
    for seed, more in ((41, {}), (42, {"events": [{"step": 1, "event": {"sensors": noise}}]})):
        open_file({"start": {"seed": seed}, "steps": 3, **more})
        page.wait("timeline.start.seed === %d && timeline.head >= 3 && timeline.events.length === %d" % (seed, len(more)))
    for script, words in (({"steps": 9001}, "9000 at most"), ({"start": {"seed": 2**53}, "steps": 3}, "write it as a text")):
        open_file(script)
        page.tab.wait_for_selector(".notice.error:has-text('%s')" % words)
        check(page.room("timeline.start.seed") == 42, "a recording that is refused plays")


def own_mass(page):
    """A base whose mass was changed gets its own again, whatever that is."""
    slider = page.tab.locator(".world .slider:has-text('Mass') input")
    told = "timeline.settings(timeline.head).mass"
    for own in (400, 423.7, 7.3, 1001 / 3):
        # As if the robot that plays had such a base.
        page.room("timeline.happen('mass', { base_mass: { mass: %r } })" % own)
        page.wait("%s === %r && !timeline.isPending" % (told, own))
        page.room("room.world.begin({ ...timeline.description, base_mass: %r })" % own)
        slider.focus()
        page.press("ArrowRight")
        page.wait("%s > %r && !timeline.isPending" % (told, own))
        heavier = page.room(told)
        page.press("ArrowLeft")
        page.wait("%s !== %r" % (told, heavier))
        check(page.room(told) == own, "a base of %r kg has %r kg afterwards" % (own, page.room(told)))


def begun_anew(page):
    """What an episode still wanted does not stop the one that begins in its place."""
    page.room("timeline.play(false)")
    page.wait("!timeline.busy")
    # A picture that wants control steps is drawn while the simulator begins.
    begun = page.room(
        """(async () => { const { simulation } = timeline, begin = simulation.begin;
        simulation.begin = function (...asked) { const answer = begin.apply(this, asked); timeline.tick(5); return answer; };
        timeline.play(true);
        try { return await room.play(room.current); } finally { simulation.begin = begin; } })()"""
    )
    check(begun, "no episode begins")
    page.wait("timeline.head >= 3 || !timeline.playing")
    check(page.room("timeline.playing"), "an episode stops the one that begins in its place")


def one_file(chromium, path):
    with browser(chromium) as opened:
        context = opened.new_context(viewport={"width": 900, "height": 640})
        context.set_offline(True)
        asked = []
        context.on("request", lambda request: asked.append(request.url))
        found = play(context, "file://" + path)
        outside = [url for url in asked if not url.startswith(("file:", "blob:", "data:"))]
        check(not outside, "the file asks for %s" % outside)
        on_a_phone(opened, path)
        return found


def on_a_phone(opened, path):
    """All is within its width, and fingers do what a pointer does."""
    narrow = opened.new_context(viewport={"width": 390, "height": 844}, is_mobile=True, has_touch=True)
    phone = Page(narrow, "file://" + path)
    phone.ready()
    width = phone.tab.evaluate("document.documentElement.scrollWidth")
    check(width <= 390, "the page is %d pixels wide on a phone of 390" % width)
    phone.wait("timeline.head >= 4")
    phone.tab.tap(".transport .play")
    phone.wait("!timeline.playing && timeline.cursor === Math.floor(timeline.cursor)")
    goals = phone.room("[...timeline.frames[0].hand_goals]")
    phone.tab.tap("button:has-text('New goals')")
    phone.wait("timeline.start.episode === 1")
    check(phone.room("[...timeline.frames[0].hand_goals]") != goals, "a tap gives the goals of before")
    phone.tab.tap(".transport button[aria-label='A control step on']")
    phone.wait("timeline.head >= 1 && timeline.cursor === 1")
    # A finger on the background turns the view and pushes nothing.
    seen = phone.room("room.view.stage.camera.position.toArray()")
    phone.tab.evaluate("scrollTo(0, 0)")
    box = phone.tab.locator(".scene canvas").bounding_box()
    touch = narrow.new_cdp_session(phone.tab)
    at = lambda x: [{"x": box["x"] + x, "y": box["y"] + 30}]
    touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": at(40)})
    for x in (60, 90, 120):
        touch.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": at(x)})
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    phone.wait("room.view.stage.camera.position.distanceTo({ x: %f, y: %f, z: %f }) > 0.05" % tuple(seen))
    check(phone.room("timeline.events.length") == 0, "a finger on the background pushes something")
    phone.quiet()


def served(chromium, address):
    with browser(chromium) as opened:
        context = opened.new_context(viewport={"width": 900, "height": 640})
        found = play(context, address)
        page = Page(context, address)
        page.ready()
        check("token" not in page.tab.url, "the token stays in the address bar: %s" % page.tab.url)
        page.quiet()

        stranger = opened.new_context().new_page()
        # The second fits into no header.
        for wrong in ("0123456789abcdef0123", "щупальце-щупальце"):
            stranger.goto("about:blank")
            stranger.goto(address.split("#")[0])
            stranger.wait_for_selector(".sign-in", timeout=WAIT)
            stranger.fill(".sign-in input", wrong)
            stranger.click(".sign-in button")
            stranger.wait_for_selector("text=does not know this token", timeout=WAIT)
            check(stranger.evaluate("typeof spaceoctopus") == "undefined", "a wrong token opens a room")
            check(stranger.evaluate("sessionStorage.length") == 0, "a wrong token is kept")
        # Whoever then knows it is let in.
        stranger.fill(".sign-in input", address.rpartition("token=")[2])
        stranger.click(".sign-in button")
        stranger.wait_for_selector("body[data-ready]", timeout=WAIT)
        end = time.monotonic() + WAIT / 1000
        while stranger.evaluate("spaceoctopus.timeline.head") < 2:
            check(time.monotonic() < end, "the robot does not move after the right token")
        strangers(opened, address)
        return found


def strangers(opened, address):
    """A page of another origin gets nothing, with the token neither; nor does a program that says it is one."""
    base, _, fragment = address.partition("#")
    token = fragment.rpartition("token=")[2]

    class Empty(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("content-type", "text/html")
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.HTTPServer(("127.0.0.1", 0), Empty) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        tab = opened.new_context().new_page()
        tab.goto("http://127.0.0.1:%d/" % server.server_port)
        asked = """([url, headers]) => fetch(url, { headers }).then((r) => r.status, () => "refused")"""
        for headers in ({}, {"authorization": "Bearer " + token}):
            found = tab.evaluate(asked, [base + "v1/checkpoints", headers])
            check(found == "refused", "a page of another origin is answered: %s" % found)
        server.shutdown()
    for headers, expected in (({"Origin": "http://evil.example"}, 403), ({"Origin": base.rstrip("/")}, 200)):
        request = urllib.request.Request(base + "v1/checkpoints", headers={"Authorization": "Bearer " + token, **headers})
        try:
            status = urllib.request.urlopen(request).status
        except urllib.error.HTTPError as error:
            status = error.code
        check(status == expected, "%s is answered with %d" % (headers, status))


def replayed(chromium, address):
    """An episode that an address or a file holds is played to its end."""
    with browser(chromium) as opened:
        page = Page(opened.new_context(viewport={"width": 700, "height": 520}), address if "://" in address else "file://" + address)
        page.ready()
        page.wait("timeline.playing")
        steps = page.room("timeline.head")
        events = page.room("timeline.events.length")
        page.room("timeline.seek(%d)" % steps)
        page.quiet()
        return {"steps": steps, "events": events, "last": page.state(steps)}


def main():
    chromium, what, *rest = sys.argv[1:]
    run = {"file": one_file, "served": served, "replayed": replayed}[what]
    print(json.dumps(run(chromium, *rest)))


if __name__ == "__main__":
    main()
