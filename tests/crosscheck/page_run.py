"""The page beside a run that trains, in a real browser.

    page_run.py CHROMIUM live ADDRESS                   a run that has just begun; prints `resume` when it wants that
    page_run.py CHROMIUM rest ADDRESS                   a run that is over, for looking only
    page_run.py CHROMIUM gone ADDRESS SECONDS           the same; prints `stop` and `start` when the service shall go and come again
    page_run.py CHROMIUM runs ADDRESS                   a directory of runs: `a` and `b` differ in their seeds, `gamma=0.5,seed=7` in more

Prints what was found as JSON on the last line; exit status 1 and a sentence where something is not as it should be.
"""

import json
import os
import signal
import sys
import tarfile
import time

from page import Page, browser, check, strangers

# What Chromium writes down by itself while nobody listens.
GONE = ("ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_INCOMPLETE_CHUNKED_ENCODING", "ERR_EMPTY_RESPONSE")


class RunPage(Page):
    def feed(self, expression):
        return self.tab.evaluate("(() => { const f = feed; return (%s); })()" % expression)

    def hears(self, expression):
        self.until(lambda: self.feed(expression), expression)

    def workers(self):
        """State and process by number of the worker."""
        rows = self.feed("(f.status?.processes ?? []).filter((p) => p.role === 'worker').map((p) => [p.worker, p.pid, p.state])")
        return {worker: (pid, state) for worker, pid, state in rows}

    def tab_named(self, name):
        self.tab.click("nav.segmented button:has-text('%s')" % name)

    def painted(self, selector):
        """How many pixels of a canvas are not empty."""
        return self.tab.evaluate(
            """(selector) => { const c = document.querySelector(selector);
            const { data } = c.getContext("2d").getImageData(0, 0, c.width, c.height);
            let n = 0; for (let i = 3; i < data.length; i += 4) if (data[i] > 0) n++; return n; }""",
            selector,
        )

    def consecutive(self):
        iterations = self.feed("f.metrics.lines.map((l) => l.iteration)")
        check(iterations == list(range(len(iterations))), "iterations are left out or stand twice: %s" % iterations)
        return len(iterations)


def grows(page):
    page.hears("f.metrics.lines.length >= 3")
    check(page.feed("f.metrics.lines[0].iteration") == 0, "the first iteration is missing")
    count = page.consecutive()
    page.hears("f.metrics.lines.length > %d" % (count + 3))
    page.until(lambda: page.painted(".growth .curve canvas") > 500, "the curve of the return is drawn")
    page.hears("new Set(f.happened.filter((h) => h.what === 'block').map((h) => h.worker)).size === 2")
    page.hears("f.happened.some((h) => h.what === 'update')")
    page.until(lambda: page.painted(".time-line canvas") > 2000, "the time line is drawn")


def death(page):
    """A worker is killed: the page shows that and its successor."""
    page.until(lambda: page.workers().get(1, (None, ""))[1] == "ready", "worker 1 is ready")
    pid, _ = page.workers()[1]
    os.kill(pid, signal.SIGKILL)
    died = "f.happened.findLast((h) => h.what === 'died' && h.worker === 1)"
    page.hears(died + " !== undefined")
    check("signal" in page.feed(died + ".cause").lower() or "kill" in page.feed(died + ".cause").lower(), "the cause is not said: %s" % page.feed(died + ".cause"))
    number = page.feed(died + ".number")
    page.hears("f.happened.some((h) => h.what === 'ready' && h.worker === 1 && h.number > %d)" % number)
    page.until(lambda: page.workers()[1][0] not in (None, pid), "the successor has another process")
    page.tab.wait_for_selector("tr[data-role=worker]:has-text('replaced 1×')")
    page.tab.wait_for_selector(".log li:has-text('worker 1 died')")


def scaled(page):
    for count in (3, 1):
        page.tab.locator(".run-room .slider input").evaluate("(s, n) => { s.value = n; s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change')); }", count)
        page.until(lambda: [state for _, state in page.workers().values()] == ["ready"] * count, "%d workers" % count)
    page.hears("f.happened.some((h) => h.what === 'left')")


def checkpoints(page):
    page.tab.click("button:has-text('Commit now')")
    page.hears("(f.checkpoints ?? []).length > 0")
    name = page.feed("f.checkpoints.at(-1).name")
    row = ".checkpoints tr[data-name='%s'] " % name
    page.tab.click(row + "button[aria-label^=Pin]")
    page.tab.wait_for_selector(row + "button[aria-label^=Pin][aria-pressed=true]")
    page.tab.once("dialog", lambda dialog: dialog.accept("mine"))
    page.tab.click(row + "button[aria-label^=Tag]")
    page.tab.wait_for_selector(row + ".tag:has-text('mine')")
    page.tab.click(row + "button[aria-label^=Promote]")
    page.tab.wait_for_selector(row + ".tag:has-text('promoted')")
    page.tab.wait_for_selector(row + "button[aria-label^=Promote][aria-pressed=true]")
    with page.tab.expect_download() as download:
        page.tab.click(row + "button[aria-label^=Download]")
    with tarfile.open(download.value.path()) as archive:
        check(any(member.endswith("policy.safetensors") for member in archive.getnames()), "the archive has no policy")
    page.tab.click(row + ".row-name")
    page.wait("room.element.hidden === false && room.current === '%s' && timeline.head >= 6" % name)
    page.tab_named("Run")
    return name


def click_block(page, name):
    """A block on the time line is made again, of an iteration whose policy is kept."""
    iteration = int(name.rpartition("-")[2])
    page.hears("f.metrics.lines.some((l) => l.iteration === %d)" % iteration)
    clicked = page.tab.evaluate(
        """(iteration) => {
            const line = run.timeLine;
            line.span.value = "60";
            line.draw();
            const box = line.boxes.findLast(({ it }) => it.what === "block" && it.iteration === iteration);
            if (box === undefined) return undefined;
            const place = line.canvas.getBoundingClientRect(), row = 22;
            const at = { clientX: place.left + box.x + 0.01, clientY: place.top + (box.row + 0.5) * row, bubbles: true };
            line.canvas.dispatchEvent(new PointerEvent("click", at));
            return box.it.shard; }""",
        iteration,
    )
    check(clicked is not None, "iteration %d is not on the time line" % iteration)
    page.tab.wait_for_selector(".made:not([data-verdict=busy]):not(:empty)")
    said = page.tab.inner_text(".made")
    check(page.tab.get_attribute(".made", "data-verdict") == "same" and "iteration %d," % iteration in said, "of iteration %d the page says: %s" % (iteration, said))


def made_again(page):
    """Blocks of kept policies are what the learner recorded; of another record the page says so."""
    offered = page.tab.eval_on_selector_all(".blocks option", "(all) => all.map((o) => Number(o.value))")
    check(len(offered) > 0, "no block is offered")
    line = page.feed("f.metrics.lines.find((l) => l.iteration === %d)" % offered[0])
    for shard in (0, len(line["blocks"]) - 1):
        page.tab.fill(".blocks input", str(shard))
        page.tab.click(".blocks button")
        page.tab.wait_for_selector(".made[data-verdict=same]:has-text('shard %d,')" % shard)
        digest = page.tab.get_attribute(".made", "data-digest")
        check(digest == line["blocks"][shard], "the page says %s, the record %s" % (digest, line["blocks"][shard]))
    page.feed("f.metrics.lines.find((l) => l.iteration === %d).blocks[0] = '%s'" % (offered[0], "0" * 32))
    page.tab.fill(".blocks input", "0")
    page.tab.click(".blocks button")
    page.tab.wait_for_selector(".made[data-verdict=another]:has-text('%s')" % ("0" * 32))
    page.feed("f.metrics.lines.find((l) => l.iteration === %d).blocks[0] = '%s'" % (offered[0], line["blocks"][0]))
    # Whose policy is gone cannot be.
    gone = page.feed("f.metrics.lines.find((l) => ![%s].includes(l.iteration)).iteration" % ", ".join(map(str, offered)))
    page.tab.evaluate("(iteration) => run.blocks.make(iteration, 0)", gone)
    page.tab.wait_for_selector(".made[data-verdict=unknown]:has-text('was not kept')")
    return offered[0]


def compared(page):
    """Two checkpoints side by side, with the numbers of the service."""
    names = page.feed("f.checkpoints.filter((c) => c.kind === 'training').map((c) => c.name)")
    first, second = names[0], names[-1]
    for name in (first, second):
        page.tab.click(".checkpoints tr[data-name='%s'] button[aria-label^=Compare]" % name)
    page.tab.wait_for_selector(".comparison tbody tr:has-text('Iterations')")
    # Thousands stand apart: "1 234".
    cells = [int("".join(text.split())) for text in page.tab.locator(".comparison tbody tr:has-text('Iterations') td.number").all_inner_texts()]
    expected = [page.feed("f.checkpoints.find((c) => c.name === '%s').iteration" % name) for name in (first, second)]
    check(cells == expected, "compared are the iterations %s, not %s" % (cells, expected))
    moved = page.tab.locator(".comparison tr[data-tensor] td:nth-child(2)").all_text_contents()
    check(len(moved) > 0 and any(float(norm) > 0 for norm in moved), "no tensor has moved: %s" % moved)
    page.tab.click(".checkpoints tr[data-name='%s'] button[aria-label^=Compare]" % first)
    page.tab.wait_for_selector(".comparison:has-text('choose a second one')")
    page.tab.click(".checkpoints tr[data-name='%s'] button[aria-label^=Compare]" % second)
    page.tab.wait_for_selector(".comparison", state="hidden")


def click_curve(page, name):
    """The policy of an iteration, or the nearest that is kept."""
    over = page.tab.locator(".growth .u-over").first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    page.tab.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"])
    page.tab.mouse.click(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"])
    # What is said of it goes away again; that it plays stays.
    page.wait("room.element.hidden === false && room.current === '%s'" % name)
    page.tab_named("Run")


def commit(page):
    """Has a policy committed and followed."""
    before = page.room("room.current")
    page.tab.evaluate("fetch('v1/checkpoints', { method: 'POST', headers: { authorization: 'Bearer ' + sessionStorage.token } }).then((r) => r.status)")
    page.wait("room.current !== '%s'" % before)
    # It plays for a while, with all arms.
    page.wait("timeline.head > %d + 2 && !timeline.isPending" % page.room("timeline.head"))


def lets_go(page):
    """Policies that the run has not kept are let go of; where one played, another one goes on."""
    for _ in range(6):
        commit(page)
    shown, held, offered = page.room("[room.slots.length, room.loaded.size, room.policies.length]")
    # One may have gone with the last list, when it had just played.
    check(held <= offered + 1 < shown, "of %d policies that were shown %d are held, %d can be chosen" % (shown, held, offered))
    step = page.room("timeline.frames.findIndex((_, step) => timeline.settings(step).arms.some(({ policy }) => timeline.isRetired(policy)))")
    check(step >= 0, "of %d policies that were shown all can play" % shown)
    # Those that are gone are null.
    arms = "timeline.settings(%d).arms.map(({ policy }) => timeline.isRetired(policy) ? null : policy)" % step
    before = page.room(arms)
    page.room("timeline.seek(%d)" % step)
    page.room("timeline.happen('delay', { delay: { steps: 1 } })")
    page.wait("timeline.head === %d && timeline.settings(%d).delay === 1" % (step, step))
    after = page.room(arms)
    check(None not in after, "who is gone moves an arm: %s" % after)
    check(all(was in (None, now) for was, now in zip(before, after)), "arms of %s are moved by %s" % (before, after))
    page.room("timeline.play(true)")
    page.wait("timeline.head > %d + 2" % step)


def follows(page):
    """The robot goes over to what is committed."""
    page.tab_named("Robot")
    page.wait("timeline.playing")
    page.tab.select_option("select[aria-label='When new policies come']", "newest")
    commit(page)
    page.wait("room.current === feed.checkpoints.at(-1).name")
    check(page.room("timeline.playing"), "a new policy stops what is played")
    lets_go(page)
    page.tab.select_option("select[aria-label='When new policies come']", "none")
    page.tab_named("Run")


def stopped_and_resumed(page):
    pid = page.feed("f.status.processes.find((p) => p.role === 'coordinator').pid")
    os.kill(pid, signal.SIGINT)
    page.tab.wait_for_selector(".lost", state="visible")
    count = page.consecutive()
    print("resume", flush=True)
    page.hears("f.heard && f.status?.state === 'training'")
    page.tab.wait_for_selector(".lost", state="hidden")
    page.hears("f.metrics.lines.length > %d" % (count + 3))
    page.consecutive()
    page.hears("f.happened.some((h) => h.what === 'block')")


def live(chromium, address):
    with browser(chromium) as opened:
        context = opened.new_context(viewport={"width": 900, "height": 640}, accept_downloads=True)
        page = RunPage(context, address.replace("#", "#run=1&"))
        page.ready()
        grows(page)
        death(page)
        scaled(page)
        name = checkpoints(page)
        click_block(page, name)
        made_again(page)
        click_curve(page, name)
        follows(page)
        page.quiet()
        stopped_and_resumed(page)
        strangers(opened, address)
        page.errors = [error for error in page.errors if not any(gone in error for gone in GONE)]
        page.quiet()
        pid = page.feed("f.status.processes.find((p) => p.role === 'coordinator').pid")
        os.kill(pid, signal.SIGINT)
        page.tab.wait_for_selector(".lost", state="visible")
        return {"pinned": name, "iterations": page.consecutive()}


def rest(chromium, address):
    with browser(chromium) as opened:
        page = RunPage(opened.new_context(viewport={"width": 1200, "height": 800}), address.replace("#", "#run=1&"))
        page.ready()
        page.tab.wait_for_selector(".checkpoints tr")
        page.hears("f.metrics.lines.length > 3")
        page.until(lambda: page.painted(".growth .curve canvas") > 500, "the curve of the return is drawn")
        page.until(lambda: "at rest" in page.tab.inner_text(".tiles"), "the run is at rest")
        check(not page.tab.is_visible("button:has-text('Commit now')"), "who may only look is offered to commit")
        for what in ("Pin", "Tag"):
            check(page.tab.locator("button[aria-label^=%s]" % what).count() == 0, "who may only look is offered to %s" % what)
        check(page.tab.locator(".run-room .slider").count() == 0, "a run that is over is offered workers")
        status = page.tab.evaluate("fetch('v1/workers', { method: 'PUT', body: '{}', headers: { authorization: 'Bearer ' + sessionStorage.token } }).then((r) => r.status)")
        check(status == 403, "a change is answered with %d" % status)
        made_again(page)
        compared(page)
        page.errors = [error for error in page.errors if "403" not in error]
        page.quiet()
        return {"iterations": page.consecutive()}


def gone(chromium, address, seconds):
    """While nobody answers the robot plays on; afterwards all is as it was, and other policies can be had."""
    with browser(chromium) as opened:
        page = RunPage(opened.new_context(viewport={"width": 900, "height": 640}), address)
        page.ready()
        page.hears("f.metrics.lines.length > 3")
        count = page.consecutive()
        page.wait("timeline.playing && timeline.head >= 2")
        print("stop", flush=True)
        page.hears("!f.heard")
        at = page.room("timeline.head")
        until = time.monotonic() + float(seconds)
        page.wait("timeline.head >= %d" % (at + 5))
        while time.monotonic() < until:
            check(not page.feed("f.heard"), "somebody answers")
            time.sleep(0.2)
        page.tab_named("Run")
        page.tab.wait_for_selector(".lost", state="visible")
        # What is at hand needs nobody.
        page.tab_named("Robot")
        page.press("n")
        page.wait("timeline.start.episode === 1 && timeline.head >= 3")
        print("start", flush=True)
        page.hears("f.heard")
        page.tab.wait_for_selector(".lost", state="hidden")
        check(page.consecutive() == count, "iterations are lost or stand twice")
        other = page.room("room.policies.map(({ name }) => name).find((name) => name !== room.current)")
        page.tab.select_option("select.policy", other)
        page.wait("room.current === '%s' && timeline.events.filter(({ event }) => event.arm !== undefined).length >= 4" % other)
        page.errors = [error for error in page.errors if not any(gone in error for gone in GONE)]
        page.quiet()
        return {"iterations": count}


def stays_put(page):
    """Who is in the list with the keyboard, or has marked something in it, keeps that while runs train, begin and go."""
    answer = {"iteration": 1000, "without": None}

    def later(route):
        response = route.fetch()
        found = [run for run in response.json()["runs"] if run["name"] != answer["without"]]
        found[0]["last"]["iteration"] = answer["iteration"] - 1
        route.fulfill(response=response, json={"runs": found})

    page.tab.route("**/v1/runs", later)
    page.tab.focus("input[aria-label='Draw b']")
    page.tab.evaluate("getSelection().selectAllChildren(document.querySelector('.runs tr[data-name=b] .name'))")
    names = lambda: page.tab.eval_on_selector_all(".runs tbody tr", "(all) => all.map((row) => row.dataset.name)")
    before = names()
    for iteration, without in ((1000, None), (2000, before[0]), (3000, None)):
        answer.update(iteration=iteration, without=without)
        words = "%d 000 / " % (iteration // 1000)
        page.until(lambda: words in page.tab.locator(".runs tbody tr").first.inner_text(), words)
        check(names() == [name for name in before if name != without], "the list is %s" % names())
        focus = page.tab.evaluate("document.activeElement.getAttribute('aria-label')")
        check(focus == "Draw b", "the keyboard is at %s" % focus)
        marked = page.tab.evaluate("String(getSelection())")
        check(marked == "b", "marked is '%s'" % marked)
    page.tab.unroute("**/v1/runs")


def runs(chromium, address):
    with browser(chromium) as opened:
        page = RunPage(opened.new_context(viewport={"width": 1200, "height": 800}), address)
        page.ready()
        check(page.tab.locator(".runs tbody tr").count() == 3, "there are three runs")
        page.tab.wait_for_selector(".legend li")
        legend = page.tab.locator(".legend li").all_inner_texts()
        check(len(legend) == 2 and "2 seeds" in legend[0] and all("gamma" in text for text in legend), "two families: %s" % legend)
        check(page.painted(".growth .curve canvas") > 500, "curves are drawn")
        stays_put(page)
        page.tab.uncheck("input[aria-label='Draw gamma=0.5,seed=7']")
        page.until(lambda: page.tab.locator(".legend li").count() == 1, "one family is left")
        page.tab.click(".runs tr[data-name='gamma=0.5,seed=7'] a")
        page.ready()
        page.wait("timeline.head >= 6")
        page.tab_named("Run")
        page.hears("f.metrics.lines.length > 3")
        page.tab.click("a.back")
        page.tab.wait_for_selector(".runs tbody tr")
        page.quiet()
        return {"legend": legend}


def main():
    chromium, what, *rest_ = sys.argv[1:]
    run = {"live": live, "rest": rest, "gone": gone, "runs": runs}[what]
    print(json.dumps(run(chromium, *rest_)), flush=True)


if __name__ == "__main__":
    main()
