"""The report of a reproduction in a real browser: what leads to an episode opens it.

    page_report.py CHROMIUM short|full DIRECTORY        DIRECTORY is what `octopus reproduce` wrote; in full every link is clicked, otherwise one
                                                        claim, and one link of each figure

Prints how many links there are and were clicked, as JSON; exit status 1 and a sentence where something is not as it should be.
"""

import base64
import json
import os
import sys
import zlib

from page import Page, browser, check

EPISODES = "a[href^='episodes.html#play=']"


def recording(href):
    packed = href.partition("#play=")[2]
    text = zlib.decompress(base64.urlsafe_b64decode(packed + "=" * (-len(packed) % 4)), wbits=-15)
    return json.loads(text)


class Report(Page):
    def opened(self, href):
        """What a click on a link led to: the episode that its address holds, played to its end."""
        wanted = recording(href)
        self.ready()
        self.wait("timeline.playing")
        script = wanted["script"]
        found = self.room("timeline.script()")
        check(found["steps"] == script["steps"] and len(found["events"]) == len(script["events"]), "another episode is opened: %d control steps" % found["steps"])
        check(self.room("room.slots") == [policy["name"] for policy in wanted["policies"]], "other policies act")
        finite = self.room("timeline.frames.every(({ state }) => state.every(Number.isFinite))")
        check(finite, "the robot is nowhere")
        return script["steps"]

    def click(self, link, report):
        href, title = link.get_attribute("href"), link.text_content()
        link.scroll_into_view_if_needed()
        box = link.bounding_box()
        # A line's box is mostly empty: where the line is.
        points = link.locator("polyline")
        is_line = points.count() > 0
        if is_line:
            # One with gaps is several lines.
            at = points.evaluate_all("(lines) => { const line = lines.reduce((a, b) => a.getTotalLength() >= b.getTotalLength() ? a : b); const p = line.getPointAtLength(line.getTotalLength() * 0.6).matrixTransform(line.getScreenCTM()); return [p.x, p.y]; }")
        else:
            at = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
        self.tab.mouse.click(*at)
        self.tab.wait_for_url("**/episodes.html#play=*")
        # Of lines that cross the one above is hit; it is one of the same figure.
        hit = self.tab.url.partition("/episodes.html")[2]
        check(hit == href.partition("episodes.html")[2] or is_line, "another link is hit at %s than that of `%s`" % (at, title))
        steps = self.opened(hit)
        return hit, steps


def claims_number(page, directory, report):
    """The episode behind the claim of the disturbed hand ends where the figure does."""
    row = page.tab.locator("tr:has-text('disturbed trajectory, position')").locator("a.watch")
    _, steps = page.click(row, report)
    with open(os.path.join(directory, "disturbance.json")) as file:
        results = json.load(file)["results"]
    figure = next(r["figure"] for r in results if r["task"] == "trajectory" and r["disturbance"] == "override")
    hand = figure["hands"][0]
    shown = page.room("[...timeline.frames[%d].hand_errors]" % steps)[6 * (hand["arm"] - 1) :][:3]
    far = max(abs(a - b) for a, b in zip(shown, hand["position_m"][steps - 1]))
    check(far < 1e-6, "the episode ends %g m from where the figure does" % far)
    page.tab.goto(report)


def main():
    chromium, form, directory = sys.argv[1:]
    report = "file://" + os.path.join(os.path.abspath(directory), "report.html")
    with browser(chromium) as opened:
        context = opened.new_context(viewport={"width": 1300, "height": 800})
        context.set_offline(True)
        page = Report(context, report)
        claims = page.tab.locator("table a.watch").count()
        rows = page.tab.locator("table").first.locator("tbody tr").count()
        check(claims == rows > 0, "%d of %d claims lead to an episode" % (claims, rows))
        figures = page.tab.locator("figure:has(svg[aria-label])")
        without = []
        for index in range(figures.count()):
            label = figures.nth(index).locator("svg").first.get_attribute("aria-label")
            if figures.nth(index).locator(EPISODES).count() == 0:
                without.append(label)
        # Curves of trainings are not of episodes, and means of policies side by side are of many.
        of_none = ("return in training" in label or label.startswith(("The robot in stage", "Sensors; ")) for label in without)
        check(all(of_none), "these lead to no episode: %s" % without)
        claims_number(page, directory, report)
        clicked = set()
        for index in range(figures.count()):
            links = figures.nth(index).locator(EPISODES)
            for number in range(links.count() if form == "full" else min(1, links.count())):
                link = page.tab.locator("figure:has(svg[aria-label])").nth(index).locator(EPISODES).nth(number)
                if link.get_attribute("href").partition("#")[2] in clicked:
                    continue
                hit, _ = page.click(link, report)
                clicked.add(hit.partition("#")[2])
                page.tab.goto(report)
        for number in range(claims if form == "full" else 0):
            page.click(page.tab.locator("table a.watch").nth(number), report)
            page.tab.goto(report)
        page.quiet()
        print(json.dumps({"claims": claims, "links": page.tab.locator(EPISODES).count(), "clicked": len(clicked)}))


if __name__ == "__main__":
    main()
