"""Taking hold of the robot in a real browser; what was done is written down for the native program to do again.

    page_hold.py CHROMIUM short FILE.html               a goal turned, an arm held, another limp
    page_hold.py CHROMIUM full FILE.html                all that, then bases of other masses, late commands, and a robot of two policies
                                                        whose base's goal is turned

FILE.html holds the policies `trajectory` (first) and `reorientation`. Prints JSON on one line: what was found, `recording`, and `states`: the bits of
all numbers of every state.
"""

import json
import math
import sys

from page import Page, browser, check

# A fine picture is not needed, and takes longer without a GPU.
SIZE = {"width": 760, "height": 560}


def rotation(a, b, c):
    """Rx(a) Ry(b) Rz(c)."""
    (sa, ca), (sb, cb), (sc, cc) = [(math.sin(x), math.cos(x)) for x in (a, b, c)]
    x = [[1, 0, 0], [0, ca, -sa], [0, sa, ca]]
    y = [[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]]
    z = [[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]]
    return product(product(x, y), z)


def product(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def angle(one, other):
    """Of the turn between two attitudes."""
    a, b = rotation(*one), rotation(*other)
    trace = sum(a[i][k] * b[i][k] for i in range(3) for k in range(3))
    return math.acos(max(-1.0, min(1.0, (trace - 1) / 2)))


class Held(Page):
    def frame(self, step, name):
        return self.room("[...timeline.frames[%d].%s]" % (step, name))

    def now(self, name):
        return self.frame(int(self.room("timeline.cursor")), name)

    def pause(self):
        self.room("timeline.play(false)")
        self.wait("!timeline.playing && timeline.cursor === Math.floor(timeline.cursor)")

    def steps(self, count):
        """So many control steps on, one after the other; where it stands then."""
        self.pause()
        at = int(self.room("timeline.cursor"))
        for step in range(at + 1, at + count + 1):
            self.press("ArrowRight")
            self.wait("timeline.cursor === %d" % step)
        return at + count

    def run(self, count):
        """The same while it plays, which is faster."""
        self.pause()
        at = int(self.room("timeline.cursor"))
        self.room("timeline.speed = 16")
        self.press("Space")
        self.wait("timeline.head >= %d" % (at + count))
        self.room("timeline.seek(%d)" % (at + count))
        self.room("timeline.cutAt(%d)" % (at + count))
        return at + count

    def moved_by(self, arm, choice):
        name = self.room("timeline.description.arms[%d]" % arm)
        self.tab.select_option(".arms select >> nth=%d" % arm, choice)
        control = "'%s'" % choice if not choice.startswith(":") else "{ policy: room.slots.indexOf('%s') }" % choice[1:]
        self.wait(
            "timeline.events.some(({ event }) => event.arm?.arm === %d && JSON.stringify(event.arm.control) === JSON.stringify(%s))" % (arm, control)
        )
        return name

    def slider(self, name, value):
        """Lets it go at a value; with the keyboard, as a pointer's place would be the browser's rounding."""
        at = self.tab.locator(".world .slider:has-text('%s') input" % name)
        at.evaluate("(s, v) => { s.value = v; s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change')); }", value)

    def ring(self, goal):
        """Where a ring is that turns the goal which is selected; the ring's axis."""
        found = self.room(
            """(() => { const { handles, stage } = room.view.goals, place = stage.renderer.domElement.getBoundingClientRect();
            room.view.draw(0);
            const centre = room.view.goals.position(%s).clone().project(stage.camera);
            for (let r = 16; r < 200; r += 2) for (let k = 0; k < 64; k++) {
                const turn = (2 * Math.PI * k) / 64;
                const x = (centre.x + 1) / 2 * place.width + r * Math.cos(turn), y = (1 - centre.y) / 2 * place.height + r * Math.sin(turn);
                handles.pointerHover({ x: 2 * x / place.width - 1, y: 1 - 2 * y / place.height, button: -1 });
                if (["X", "Y", "Z"].includes(handles.axis)) return { x: place.left + x, y: place.top + y, turn, axis: handles.axis };
            }
            return null; })()"""
            % goal
        )
        check(found is not None, "the goal has no ring that turns it")
        return found

    def turn(self, goal, pixels):
        """Drags a ring of the selected goal by so many pixels along itself."""
        ring = self.ring(goal)
        mouse = self.tab.mouse
        mouse.move(ring["x"], ring["y"])
        self.wait("room.view.goals.axis === '%s'" % ring["axis"])
        mouse.down()
        along = (-math.sin(ring["turn"]), math.cos(ring["turn"]))
        for part in range(1, 9):
            mouse.move(ring["x"] + pixels * along[0] * part / 8, ring["y"] + pixels * along[1] * part / 8)
        mouse.up()
        mouse.move(5, 5)
        return ring["axis"]


def turned_goal(page):
    """A hand's goal that is turned stays where it is, and the hand follows."""
    before = page.now("hand_goals")[:6]
    page.press("1")
    page.wait("room.view.goals.selected === 0")
    page.press("r")
    page.wait("room.view.goals.mode === 'rotate'")
    page.turn("0", 14)
    page.wait("timeline.events.some(({ event }) => event.hand_goal?.arm === 0)")
    after = page.now("hand_goals")[:6]
    way = max(abs(a - b) for a, b in zip(before[:3], after[:3]))
    check(way < 1e-6, "a goal that is turned moves by %g m" % way)
    by = angle(before[3:], after[3:])
    check(0.05 < by < 1.5, "the goal is turned by %.3f rad" % by)
    page.press("Escape")
    at = page.run(100)
    errors = page.frame(at, "position_error")[0], page.frame(at, "orientation_error")[0]
    check(errors[0] < 0.025 and errors[1] < 0.040, "the hand is %.4f m and %.4f rad from the goal that was turned" % errors)
    return {"turned_rad": by, "position_m": errors[0], "orientation_rad": errors[1]}


def held_and_limp(page):
    """An arm that is held gets no commands, one that is limp no torques, and the others go on."""
    held, limp = 2, 3
    page.moved_by(held, "hold")
    page.moved_by(limp, "limp")
    begin = int(page.room("timeline.cursor"))
    end = page.steps(6)
    of = lambda values, arm: values[6 * arm : 6 * arm + 6]
    for step in range(begin + 1, end + 1):
        commands, torques = page.frame(step, "commands"), page.frame(step, "torques")
        check(not any(of(commands, held)), "an arm that is held is commanded %s" % of(commands, held))
        check(not any(of(torques, limp)), "an arm that is limp has torques %s" % of(torques, limp))
        check(any(of(commands, 0)) and any(of(torques, held)), "the others stand still, too")
    # Back in time the controls say what held there.
    page.room("timeline.seek(%d)" % (begin - 1))
    chosen = page.tab.locator(".arms select >> nth=%d" % held)
    page.until(lambda: chosen.input_value() == ":trajectory", "the arm moves by its policy before it was held")
    page.room("timeline.seek(%d)" % end)
    page.until(lambda: chosen.input_value() == "hold", "the arm is held afterwards")
    page.moved_by(held, ":trajectory")
    page.moved_by(limp, ":trajectory")


def weighed(page):
    """The same push takes a light base farther than a heavy one."""
    begin = int(page.room("timeline.cursor"))
    start = page.frame(begin, "state")[:3]
    x, y = page.on_screen(page.frame(begin, "bodies")[12:15])
    ways, forces = {}, {}
    for mass in (100, 1000):
        page.room("timeline.seek(%d)" % begin)
        page.slider("Mass", mass)
        page.wait("timeline.events.some(({ step, event }) => step === %d && event.base_mass?.mass === %d)" % (begin, mass))
        page.tab.mouse.move(x, y)
        page.tab.mouse.down()
        page.tab.mouse.move(x + 30, y + 5)
        page.press("ArrowRight")
        page.wait("timeline.cursor === %d" % (begin + 1))
        page.tab.mouse.up()
        at = page.run(10)
        ways[mass] = math.dist(page.frame(at, "state")[:3], start)
        pushes = page.room("timeline.events.filter(({ event }) => event.effect !== undefined).map(({ event }) => event.effect.effect.wrench.force)")
        check(len(pushes) == 1, "there are %d pushes: %s" % (len(pushes), page.room("timeline.events")))
        forces[mass] = math.hypot(*pushes[0])
        check(page.room("timeline.events.filter(({ event }) => event.base_mass !== undefined).length") == 1, "another future keeps the mass of the first")
    check(abs(forces[100] / forces[1000] - 1) < 1e-3, "the pushes are %s N" % forces)
    # Arms of 80 kg go along with both.
    check(ways[100] > 3 * ways[1000] > 0.003, "light and heavy bases move by %s" % ways)
    # Whoever was pushed would drift for ever: back to before it, with a third mass.
    page.room("timeline.seek(%d)" % (begin - 1))
    page.room("timeline.cutAt(%d)" % (begin - 1))
    page.slider("Mass", 350)
    page.wait("timeline.events.some(({ event }) => event.base_mass?.mass === 350)")
    page.steps(1)
    return {"ways_m": ways, "force_n": forces[100]}


def late(page):
    """Commands come two control steps after the policy has decided."""
    before = page.steps(3)
    actions, commands = page.frame(before, "actions"), page.frame(before, "commands")
    scale = commands[0] / actions[0]
    page.slider("Delay", 2)
    page.wait("timeline.events.some(({ event }) => event.delay?.steps === 2)")
    begin = int(page.room("timeline.cursor"))
    end = page.steps(6)
    for step in range(begin + 3, end + 1):
        check(page.frame(step, "counters")[3] == 2, "the simulator counts another delay")
        decided, done = page.frame(step - 2, "actions"), page.frame(step, "commands")
        far = max(abs(scale * a - b) for a, b in zip(decided, done))
        check(far < 1e-5, "commands are not those of two steps before, by %g" % far)
    page.slider("Delay", 0)


def reassembled(page):
    """Arm 2 reaches while the others turn the base, as far as its goal is turned."""
    for arm in (0, 2, 3):
        page.moved_by(arm, ":reorientation")
    before = page.now("base_goal")
    page.press("b")
    page.wait("room.view.goals.selected === 'base' && room.view.goals.mode === 'rotate'")
    page.turn("'base'", 4)
    page.wait("timeline.events.some(({ event }) => event.base_goal !== undefined)")
    after = page.now("base_goal")
    by = angle(before, after)
    check(0.02 < by < 0.4, "the base's goal is turned by %.3f rad" % by)
    page.press("Escape")
    at = page.run(150)
    base, hand = page.frame(at, "base_error")[0], page.frame(at, "position_error")[1]
    # The paper's claims of a robot of two policies.
    check(base < 0.035, "the base is %.4f rad from its goal" % base)
    check(hand < 0.040, "the hand is %.4f m from its goal" % hand)
    return {"turned_rad": by, "base_rad": base, "position_m": hand}


def hold(chromium, path, whole):
    with browser(chromium) as opened:
        context = opened.new_context(viewport=SIZE)
        context.set_offline(True)
        page = Held(context, "file://" + path)
        page.ready()
        page.wait("timeline.head >= 2")
        page.pause()
        page.room("timeline.cutAt(timeline.cursor)")
        found = {"goal": turned_goal(page)}
        held_and_limp(page)
        if whole:
            found["weighed"] = weighed(page)
            late(page)
            found["reassembled"] = reassembled(page)
        page.room("timeline.cutAt(timeline.cursor)")
        found["recording"] = page.room("room.recording()")
        found["states"] = page.room("timeline.frames.map(({ state }) => [...new Uint32Array(state.slice().buffer)])")
        page.quiet()
        return found


def main():
    chromium, what, path = sys.argv[1:]
    print(json.dumps(hold(chromium, path, {"short": False, "full": True}[what])))


if __name__ == "__main__":
    main()
