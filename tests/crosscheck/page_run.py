"""The page beside a run that trains, in a real browser.

    page_run.py CHROMIUM live ADDRESS                   a run that has just begun; prints `resume` when it wants that
    page_run.py CHROMIUM rest ADDRESS                   a run that is over, for looking only
    page_run.py CHROMIUM runs ADDRESS                   a directory of runs: `a` and `b` differ in their seeds, `c` in more

Prints what was found as JSON on the last line; exit status 1 and a sentence where something is not as it should be.
"""

import http.server
import json
import os
import signal
import sys
import tarfile
import threading
import urllib.error
import urllib.request

from page import Page, browser, check

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
    check(page.painted(".growth .curve canvas") > 500, "the curve of the return is not drawn")
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
    with page.tab.expect_download() as download:
        page.tab.click(row + "button[aria-label^=Download]")
    with tarfile.open(download.value.path()) as archive:
        check(any(member.endswith("policy.safetensors") for member in archive.getnames()), "the archive has no policy")
    page.tab.click(row + ".row-name")
    page.wait("room.element.hidden === false && room.current === '%s' && timeline.head >= 6" % name)
    page.tab_named("Run")
    return name


def click_curve(page, name):
    """The policy of an iteration, or the nearest that is kept."""
    over = page.tab.locator(".growth .u-over").first
    box = over.bounding_box()
    page.tab.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"])
    page.tab.mouse.click(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"])
    page.tab.wait_for_selector(".notice:has-text('plays')")
    page.wait("room.element.hidden === false && room.current === '%s'" % name)
    page.tab_named("Run")


def follows(page):
    """The robot goes over to what is committed."""
    page.tab_named("Robot")
    page.wait("timeline.playing")
    page.tab.select_option("select[aria-label='When new policies come']", "newest")
    before = page.room("room.current")
    page.tab.evaluate("fetch('v1/checkpoints', { method: 'POST', headers: { authorization: 'Bearer ' + sessionStorage.token } }).then((r) => r.status)")
    page.wait("room.current !== '%s'" % before)
    page.wait("room.current === feed.checkpoints.at(-1).name")
    check(page.room("timeline.playing"), "a new policy stops what is played")
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


def live(chromium, address):
    with browser(chromium) as opened:
        context = opened.new_context(viewport={"width": 900, "height": 640}, accept_downloads=True)
        page = RunPage(context, address.replace("#", "#run=1&"))
        page.ready()
        grows(page)
        death(page)
        scaled(page)
        name = checkpoints(page)
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
        check(page.painted(".growth .curve canvas") > 500, "the curve of the return is not drawn")
        check(not page.tab.is_visible("button:has-text('Commit now')"), "who may only look is offered to commit")
        for what in ("Pin", "Tag"):
            check(page.tab.locator("button[aria-label^=%s]" % what).count() == 0, "who may only look is offered to %s" % what)
        check(page.tab.locator(".run-room .slider").count() == 0, "a run that is over is offered workers")
        status = page.tab.evaluate("fetch('v1/workers', { method: 'PUT', body: '{}', headers: { authorization: 'Bearer ' + sessionStorage.token } }).then((r) => r.status)")
        check(status == 403, "a change is answered with %d" % status)
        page.errors = [error for error in page.errors if "403" not in error]
        page.quiet()
        return {"iterations": page.consecutive()}


def runs(chromium, address):
    with browser(chromium) as opened:
        page = RunPage(opened.new_context(viewport={"width": 1200, "height": 800}), address)
        page.ready()
        check(page.tab.locator(".runs tbody tr").count() == 3, "there are three runs")
        page.tab.wait_for_selector(".legend li")
        legend = page.tab.locator(".legend li").all_inner_texts()
        check(len(legend) == 2 and "2 seeds" in legend[0] and all("gamma" in text for text in legend), "two families: %s" % legend)
        check(page.painted(".growth .curve canvas") > 500, "curves are drawn")
        page.tab.uncheck("input[aria-label='Draw c']")
        page.until(lambda: page.tab.locator(".legend li").count() == 1, "one family is left")
        page.tab.click(".runs tr[data-name=a] a")
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
    run = {"live": live, "rest": rest, "runs": runs}[what]
    print(json.dumps(run(chromium, *rest_)), flush=True)


if __name__ == "__main__":
    main()
