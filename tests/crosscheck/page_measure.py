"""What the page costs, in a real browser; for BENCHMARKS.md.

    page_measure.py CHROMIUM robot ADDRESS [GPU]        time to the first picture, a control step, frames a second; with the GPU of this machine or without one
    page_measure.py CHROMIUM memory ADDRESS MINUTES     memory of a page beside a run that trains
    page_measure.py CHROMIUM watch ADDRESS PAGES        opens so many pages on the run until standard input ends
    page_measure.py - streams ADDRESS PAGES             the same without a browser: as many streams as so many pages on other machines would have

Prints JSON, for `memory` a line a minute.
"""

import json
import select
import sys
import time
import urllib.request

from playwright.sync_api import sync_playwright

from page import DRAWING, WAIT, check

# Chromium's own way to a GPU; nobody looks at the window.
WITH_GPU = ["--use-gl=egl", "--enable-gpu", "--ignore-gpu-blocklist"]


def median(values):
    return sorted(values)[len(values) // 2]


def opened(playwright, chromium, flags):
    return playwright.chromium.launch(executable_path=chromium, args=flags)


def robot(chromium, address, gpu=None):
    with sync_playwright() as playwright:
        browser = opened(playwright, chromium, WITH_GPU if gpu else DRAWING)
        firsts = []
        for _ in range(5):
            tab = browser.new_context(viewport={"width": 1280, "height": 800}).new_page()
            tab.set_default_timeout(WAIT)
            tab.goto(address)
            tab.wait_for_selector("body[data-ready]")
            # From the beginning of the navigation until the first picture of the robot has been drawn.
            firsts.append(tab.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now()))))"))
            sizes = tab.evaluate("performance.getEntriesByType('resource').map((r) => [r.name, r.encodedBodySize])")
            if len(firsts) < 5:
                tab.context.close()
        end = time.monotonic() + 20
        rates, steps = [], []
        while time.monotonic() < end:
            time.sleep(1)
            rate, step = tab.evaluate("(({ framesPerSecond, stepMs }) => [Number(framesPerSecond), Number(stepMs)])(document.querySelector('.robot-room').dataset)")
            rates.append(rate)
            steps.append(step)
        renderer = tab.evaluate(
            """(() => { const gl = spaceoctopus.view.stage.renderer.getContext(), info = gl.getExtension('WEBGL_debug_renderer_info');
            return info === null ? 'unknown' : gl.getParameter(info.UNMASKED_RENDERER_WEBGL); })()"""
        )
        transferred = {name.split("/")[-1]: size for name, size in sizes if "/page/" in name}
        return {"first_picture_ms": [round(x) for x in firsts], "step_ms": median(steps), "frames_per_s": median(rates), "renderer": renderer, "bytes": transferred}


def memory(chromium, address, minutes):
    with sync_playwright() as playwright:
        browser = opened(playwright, chromium, DRAWING)
        tab = browser.new_context(viewport={"width": 900, "height": 640}).new_page()
        tab.set_default_timeout(WAIT)
        tab.goto(address.replace("#", "#run=1&"))
        tab.wait_for_selector("body[data-ready]")
        tools = tab.context.new_cdp_session(tab)
        begin = time.monotonic()
        used = []
        for minute in range(int(minutes) + 1):
            time.sleep(max(0, begin + 60 * minute - time.monotonic()))
            tools.send("HeapProfiler.collectGarbage")
            heap = tools.send("Runtime.getHeapUsage")["usedSize"]
            nodes = tools.send("Memory.getDOMCounters")["nodes"]
            lines = tab.evaluate("feed.metrics.lines.length")
            used.append(heap)
            print(json.dumps({"minute": minute, "heap_mb": round(heap / 1e6, 2), "nodes": nodes, "iterations": lines, "happened": tab.evaluate("feed.happened.length")}), flush=True)
        return {"first_mb": used[0] / 1e6, "last_mb": used[-1] / 1e6}


def watch(chromium, address, pages):
    with sync_playwright() as playwright:
        browser = opened(playwright, chromium, DRAWING)
        context = browser.new_context(viewport={"width": 900, "height": 640})
        for _ in range(int(pages)):
            tab = context.new_page()
            tab.set_default_timeout(WAIT)
            tab.goto(address.replace("#", "#run=1&"))
            tab.wait_for_selector("body[data-ready]")
        print("open", flush=True)
        sys.stdin.read()
        return {}


def streams(_, address, pages):
    base, _, fragment = address.partition("#")
    token = fragment.rpartition("token=")[2]
    request = urllib.request.Request(base + "v1/events", headers={"Authorization": "Bearer " + token})
    held = [urllib.request.urlopen(request) for _ in range(int(pages))]
    check(all(stream.status == 200 for stream in held), "a stream is refused")
    print("open", flush=True)
    while True:
        ready, _, _ = select.select([sys.stdin, *held], [], [])
        if sys.stdin in ready and not sys.stdin.read(1):
            return {}
        for stream in ready:
            if stream is not sys.stdin:
                stream.read1(1 << 16)


def main():
    chromium, what, *rest = sys.argv[1:]
    print(json.dumps({"robot": robot, "memory": memory, "watch": watch, "streams": streams}[what](chromium, *rest)), flush=True)


if __name__ == "__main__":
    main()
