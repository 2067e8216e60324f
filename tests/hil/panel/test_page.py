"""Page of the panel in a Chromium: what people see and press, and what a page of another origin gets."""

from __future__ import annotations

import functools
import http.server
import shutil
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from hil.alarms import AlarmWatch
from hil.run_folder import RunFolder, read_notes
from tests.hil.alarmed_run import FLOW, RUN, TANK, AlarmedRun, alarmed_run

playwright = pytest.importorskip("playwright.sync_api", reason="the page's tests need playwright")
pytest.importorskip("uvicorn", reason="the panel needs uvicorn")
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium here (Debian: chromium)")
FOREIGN = """<form id=f action="%(verb)s" method=post enctype="text/plain" target=t>
<input name='{"verb": "abort", "confirmed": true, "x": "' value='"}'></form>
<iframe name=t></iframe><iframe src="%(panel)s/"></iframe>
<script>
const found = [], body = '{"verb": "abort", "confirmed": true}', credentials = "include";
const ask = (url, rest, read) => fetch(url, {credentials, ...rest})
  .then(read, () => "refused").then((said) => found.push(said));
ask("%(panel)s/api/runs", {}, (answer) => answer.text());
ask("%(verb)s", {method: "POST", headers: {"content-type": "application/json"}, body}, (answer) => answer.text());
ask("%(verb)s", {method: "POST", mode: "no-cors", body}, () => "sent");
f.submit();
</script>"""
"""Page of another site that tries to read and to steer, with the cookies that the browser has."""
EVIL = "<img src=x onerror=document.title='owned'>"


@pytest.fixture(scope="module")
def thread() -> Iterator[ThreadPoolExecutor]:
    """A thread of its own for playwright, whose loop must not meet that of the tests."""
    with ThreadPoolExecutor(1) as made:
        yield made


@pytest.fixture(scope="module")
def browser(thread: ThreadPoolExecutor) -> Iterator[Any]:
    started = thread.submit(playwright.sync_playwright().start).result(30)
    launch = functools.partial(started.chromium.launch, executable_path=BROWSER, args=["--no-sandbox"])
    opened = thread.submit(launch).result(30)
    yield opened
    thread.submit(opened.close).result(30)
    thread.submit(started.stop).result(30)


@pytest.fixture
def run(tmp_path: Path) -> Iterator[AlarmedRun]:
    tank = TANK.model_copy(update={"doc": EVIL})
    made = alarmed_run(tmp_path, (tank, FLOW, *RUN))
    made.step(55.0)
    yield made
    made.finish()


@pytest.fixture
def panel(run, tmp_path):
    from tests.hil.panel.served import Served, Steered

    steered = Steered(run.path / "control.sock")
    served = Served(tmp_path)
    served.steered = steered
    yield served
    served.close()
    steered.close()


@pytest.fixture
def visit(thread, browser, panel) -> Callable[[Callable[[Any], None]], None]:
    """Open the printed address on a tablet, and let a function look at the page; script errors fail the test."""

    def visited(look: Callable[[Any], None]) -> None:
        context = browser.new_context(viewport={"width": 820, "height": 1180}, has_touch=True)
        page = context.new_page()
        page.set_default_timeout(15_000)
        problems: list[str] = []
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("console", lambda said: problems.append(said.text) if "Content Security" in said.text else None)
        try:
            page.goto(f"{panel.url}/?token={panel.access.token}")
            page.wait_for_selector(".card canvas")
            look(page)
        finally:
            context.close()
        assert problems == []

    return lambda look: thread.submit(visited, look).result(60)


def test_a_person_sees_the_run_and_steers_it_by_confirmed_presses(visit, panel, run):
    def look(page: Any) -> None:
        assert "token" not in page.url
        assert page.inner_text("#state") == "running"
        row = page.locator("tr", has_text="T_tank")
        assert "55.00" in row.inner_text() and "°C" in row.inner_text()
        assert page.locator(".card").count() >= 6
        paces = page.evaluate(
            "() => [[[0, 0], [1000, 20], [2000, 40]], [[0, 5], [1000, 6]], [[0, 0]], [[0, 0], [9000, 0], [10000, 30]]]"
            ".map(stateStep)"
        )
        assert paces == [20, 1, 1, 3]  # the last: ten seconds without a row, which no line joins
        drawn = page.evaluate(
            "() => [...document.querySelectorAll('canvas')].map(c => c.getContext('2d')"
            ".getImageData(0, 0, c.width, c.height).data.some(v => v > 0))"
        )
        assert all(drawn)
        page.get_by_role("button", name="Abort").tap()
        assert page.inner_text("#ask-title").startswith("Abort: ")
        page.click("#cancel")
        assert panel.steered.asked == []
        page.get_by_role("button", name="Pause").tap()
        page.fill("[name=reason]", "topping up")
        page.fill("[name=by]", "Ada")
        page.click("#confirm")
        page.wait_for_selector("dialog:not([open])", state="attached")
        assert panel.steered.asked == [{"verb": "pause", "reason": "topping up (panel, Ada)"}]
        panel.steered.refuses = "the run is finishing: it takes no verb any more"
        page.get_by_role("button", name="Abort").tap()
        page.click("#confirm")
        page.wait_for_function(
            "() => document.getElementById('ask-error').textContent.includes('takes no verb any more')"
        )

    visit(look)


def test_text_of_a_run_stays_text_and_alarms_are_acknowledged_and_shelved(visit, run):
    def look(page: Any) -> None:
        assert EVIL in page.inner_text("#alarms")
        page.get_by_role("button", name="Add note").click()
        page.fill("[name=text]", EVIL)
        page.fill("[name=by]", "<b>Ada")
        page.click("#confirm")
        page.wait_for_function("() => document.getElementById('log').textContent.includes('onerror')", timeout=20_000)
        page.get_by_role("button", name="Acknowledge").click()
        page.click("#confirm")
        page.wait_for_selector(".alarm.quiet")
        page.get_by_role("button", name="Shelve").click()
        page.fill("[name=reason]", EVIL)
        page.click("#confirm")
        page.get_by_role("button", name="End shelving").wait_for()
        assert page.locator("#alarms img, #log img, #log b b").count() == 0 and "owned" not in page.title()
        assert [(note.by, note.text) for note in read_notes(RunFolder(run.path))] == [("<b>Ada", EVIL)]
        with AlarmWatch(run.path) as watch:
            assert [item.state.value for item in watch.poll().standing()] == ["shelved, active"]

    visit(look)


def test_a_late_viewer_gets_the_past_and_a_lost_connection_is_said(visit, panel, run):
    def look(page: Any) -> None:
        run.step(55.0)
        page.wait_for_function("() => document.getElementById('clock').textContent.includes('0:00:44')")
        first = page.evaluate("() => [courses.all.time[0], courses.all.series.get('T_tank').mean[0]]")
        assert first == [0.5, 25.0]
        assert page.inner_text("#link") in ("live", "last row 0 s ago") or "last row" in page.inner_text("#link")
        panel._server.should_exit = True
        page.wait_for_function("() => document.getElementById('link').textContent.startsWith('connection lost')")
        assert "stale" in page.get_attribute("body", "class")

    visit(look)


def test_a_killed_run_offers_no_verb(visit, run):
    def look(page: Any) -> None:
        run.run._held.close()
        page.wait_for_function("() => document.getElementById('state').textContent === 'interrupted'")
        assert page.locator("#verbs button:enabled").count() == 0
        assert page.inner_text("#link") == "interrupted"

    visit(look)


COURSE = """(gap) => {
  const time = [...Array(20).keys()].map((k) => k + 0.5 + (k < 10 ? 0 : gap));
  const cells = { mean: time.map(() => 1), low: time.map(() => 1), high: time.map(() => 1) };
  const course = new Course({ bin_s: 1, time_s: time, series: { x: cells } }, 1);
  const curves = [{ name: "x", color: "red" }], moves = [];
  const pen = new Proxy({}, { get: (kept, name) => name === "measureText" ? () => ({ width: 9 })
    : name === "moveTo" && kept.strokeStyle === "red" ? (x) => moves.push(x) : name in kept ? kept[name] : () => {},
    set: (kept, name, value) => { kept[name] = value; return true; } });
  drawCourse({ clientWidth: 300, clientHeight: 100, getContext: () => pen }, course, curves, -Infinity, null);
  return moves.length;
}"""
"""Number of lines that a course is drawn in, with `gap` s without rows in the middle of it."""


def test_a_line_breaks_where_there_are_no_rows_and_every_signal_has_a_curve(visit):
    def look(page: Any) -> None:
        assert [page.evaluate(COURSE, gap) for gap in (0, 1, 5, 50)] == [1, 1, 2, 2]
        many = """() => { const unit = "x", kind = "measured";
            shown.values = [...Array(21).keys()].map((k) => ({ name: `s${k}`, unit, kind }));
            makePlots({ sensors: [], twins: [] });
            return plots.map((plot) => [plot.curves.length, new Set(plot.curves.map((c) => c.color)).size]); }"""
        assert page.evaluate(many) == [[8, 8], [8, 8], [5, 5]]

    visit(look)


def test_a_page_of_another_origin_reads_nothing_and_steers_nothing(visit, panel, run, tmp_path):
    def look(page: Any) -> None:
        site = tmp_path / "site"
        site.mkdir()
        url = f"{panel.url}/api/runs/{run.path.name}/verb"
        site.joinpath("index.html").write_text(FOREIGN % {"panel": panel.url, "verb": url}, encoding="utf-8")
        handler = functools.partial(_Quiet, directory=str(site))
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            other = page.context.new_page()
            other.goto(f"http://localhost:{server.server_port}/")  # the same machine, another site
            other.wait_for_function("() => found.length === 3")
            assert sorted(other.evaluate("() => found"))[:2] == ["refused", "refused"]
            other.wait_for_timeout(300)
        finally:
            server.shutdown()
            server.server_close()
            thread.join(5)
        assert panel.steered.asked == []

    visit(look)


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *arguments: object) -> None:
        pass


CONTRAST = """() => {
  const part = (text) => text.match(/[\\d.]+/g).slice(0, 3).map((c) => c / 255)
    .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
  const bright = (text) => { const [r, g, b] = part(text); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const backOf = (node) => {
    for (; node; node = node.parentElement) {
      const back = getComputedStyle(node).backgroundColor;
      if (!back.endsWith(", 0)")) return back;
    }
    return "rgb(255, 255, 255)";
  };
  const found = [];
  for (const node of document.querySelectorAll("main *, header *")) {
    const own = [...node.childNodes].some((one) => one.nodeType === 3 && one.data.trim());
    if (!own || node.disabled || !node.checkVisibility()) continue;
    const [a, b] = [bright(getComputedStyle(node).color), bright(backOf(node))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) found.push(`${node.className} ${node.textContent.slice(0, 30)} ${ratio.toFixed(2)}`);
  }
  return found;
}"""
"""Texts whose contrast is below 4.5, that of WCAG 2.2 for small text."""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_is_readable_in_the_light_and_in_the_dark(visit, scheme):
    def look(page: Any) -> None:
        page.emulate_media(color_scheme=scheme)
        is_dark = page.evaluate("getComputedStyle(document.documentElement).backgroundColor") == "rgb(18, 22, 26)"
        assert is_dark == (scheme == "dark")
        assert page.evaluate(CONTRAST) == []

    visit(look)


def test_a_state_that_is_sent_again_is_one_point_of_a_course(visit):
    again = """() => { const cells = () => ({ mean: [1], low: [1], high: [1] });
      const course = new Course({ bin_s: 10, time_s: [5], series: { x: cells() } }, 1);
      for (let k = 0; k < 9; k++) course.add(9, { x: 3 });
      return course.series.get("x").mean; }"""
    visit(lambda page: page.evaluate(again) == [2.0] or pytest.fail("the point was counted again"))
