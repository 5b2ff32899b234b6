"""`python -m benchmarks.page [--positioners 500 5000] [--seconds 60] [--pictures FOLDER] [--out FILE.json]`.

The live page in Chromium, every positioner in motion: frames a second and time between two, bytes on the
WebSocket, CPU of page and service, memory at the begin and at the end. The service is the real one, told of
moves by a clock (`benchmarks.page.motion`).

The page is smooth when it draws no less often than pictures come and half of the frames come within 100 ms,
which is the time between two pictures; exit code 1 where it is not, or where the console has an error or a
warning.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.service.web.stream import PICTURE_S

from .chromium import SIZE, launched
from .processes import cpu_s, kind, memory_mb, tree

SETTLE_S = 5.0
"""After the page was opened, before anything is counted."""
COUNTER = """
window.counted = { bytes: 0, messages: 0, pictures: 0, events: 0 };
const Plain = WebSocket;
window.WebSocket = class extends Plain {
  constructor(...how) {
    super(...how);
    this.addEventListener("message", ({ data }) => {
      const text = typeof data === "string";
      counted.bytes += text ? new Blob([data]).size : data.byteLength;
      counted[text ? "events" : "pictures"]++;
    });
  }
};
"""
"""Counts what comes on the stream; before the page's own code."""
FRAMES = """(seconds) => new Promise((done) => {
  const { view, model } = fiberloom, gaps = [], begin = performance.now();
  const was = { ...counted, drawn: view.drawn, still: view.stillDrawn };
  performance.clearResourceTimings();
  let last = NaN;
  const frame = (now) => {
    if (Number.isFinite(model.time_s) && Number.isFinite(last)) gaps.push(now - last);
    last = Number.isFinite(model.time_s) ? now : NaN;
    if (performance.now() - begin < 1000 * seconds) { requestAnimationFrame(frame); return; }
    const of = (name) => counted[name] - was[name];
    const fetched = performance.getEntriesByType("resource").reduce((sum, e) => sum + e.transferSize, 0);
    done({ gaps, fetched, seconds: (performance.now() - begin) / 1000,
      bytes: of("bytes"), pictures: of("pictures"), events: of("events"),
      drawn: view.drawn - was.drawn, still: view.stillDrawn - was.still });
  };
  requestAnimationFrame(frame);
})"""
"""Between two frames while arms move, and what was counted meanwhile."""


@contextmanager
def moving(positioners: int) -> Iterator[tuple[str, int]]:
    """The service of so many in motion, in a process of its own: its address and number."""
    words = [sys.executable, "-m", "benchmarks.page.motion", "--positioners", str(positioners)]
    service = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    try:
        assert service.stdout is not None
        url = service.stdout.readline().strip()
        if not url:
            raise SystemExit("the service has not begun")
        yield url, service.pid
    finally:
        service.terminate()
        service.wait()


def measure(browser: Any, positioners: int, seconds: float, pictures: Path | None) -> dict[str, Any]:
    """The page of so many in motion for so long, in a `browser`; `pictures`: a folder for screenshots."""
    with moving(positioners) as (url, service):
        context = browser.new_context(viewport=SIZE)
        page, wrong = context.new_page(), []
        page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.add_init_script(COUNTER)
        page.goto(url)
        page.wait_for_selector("#link:not(.off)", timeout=60e3)
        page.wait_for_selector("#mark:not([hidden])", timeout=60e3)
        time.sleep(SETTLE_S)
        chromes = {pid: kind(pid) for pid in tree(os.getpid()) if kind(pid)}
        before = {pid: cpu_s(pid) for pid in (*chromes, service)}
        memory = {"page": _memory(chromes), "service": memory_mb(service), "heap": _heap(context, page)}
        seen = page.evaluate(FRAMES, seconds)
        used = {pid: cpu_s(pid) - before[pid] for pid in before}
        after = {"page": _memory(chromes), "service": memory_mb(service), "heap": _heap(context, page)}
        if pictures is not None:
            _pictures(page, pictures, positioners)
        context.close()
    return _figures(seen) | {
        "positioners": positioners,
        "page_cpu_share": sum(used[pid] for pid in chromes) / seen["seconds"],
        "renderer_cpu_share": sum(used[p] for p, what in chromes.items() if what == "renderer")
        / seen["seconds"],
        "service_cpu_share": used[service] / seen["seconds"],
        **{f"{name}_mb": [round(memory[name], 1), round(after[name], 1)] for name in memory},
        "console": wrong,
        "load_average": os.getloadavg()[0],
    }


def _figures(seen: dict[str, Any]) -> dict[str, Any]:
    gaps, seconds = np.array(seen["gaps"]), seen["seconds"]
    half, most, worst = np.percentile(gaps, [50, 95, 100]) if len(gaps) else (np.nan,) * 3
    return {
        "seconds": seconds,
        "frames_a_second": 1e3 * len(gaps) / gaps.sum() if len(gaps) else 0.0,
        "frame_ms_median": half,
        "frame_ms_95": most,
        "frame_ms_worst": worst,
        "drawn": seen["drawn"],
        "still_drawn": seen["still"],
        "pictures": seen["pictures"],
        "events": seen["events"],
        "bytes_a_second": seen["bytes"] / seconds,
        "fetched_mb": seen["fetched"] / 1e6,
    }


def _memory(chromes: dict[int, str]) -> float:
    return sum(memory_mb(pid) for pid in chromes)


def _heap(context: Any, page: Any) -> float:
    """Of the page's own objects, after what is not used was given back, MB."""
    session = context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    session.send("Performance.enable")
    found = {m["name"]: m["value"] for m in session.send("Performance.getMetrics")["metrics"]}
    session.detach()
    return float(found["JSHeapUsedSize"]) / 2**20


def _pictures(page: Any, folder: Path, positioners: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=folder / f"page-{positioners}.png")
    page.evaluate("fiberloom.view.show(Math.floor(fiberloom.model.plane.n / 2), true)")
    time.sleep(1.0)
    page.screenshot(path=folder / f"page-{positioners}-near.png")


def is_smooth(found: dict[str, Any]) -> bool:
    """It draws no less often than pictures come, half of the frames within the time between two."""
    return bool(found["drawn"] >= found["pictures"] > 0 and found["frame_ms_median"] <= 1e3 * PICTURE_S)


def told(found: dict[str, Any]) -> str:
    """A few lines for one array."""
    text = LINES.format(
        verdict="smooth" if is_smooth(found) else "NOT SMOOTH",
        stream=found["bytes_a_second"] / 1e3,
        **{name: "{:.0f} to {:.0f} MB".format(*found[f"{name}_mb"]) for name in ("page", "heap", "service")},
        **found,
    )
    return "\n".join([text, *(f"  console: {line}" for line in found["console"])])


LINES = """\
{positioners} positioners, {seconds:.0f} s, load {load_average:.1f}: {verdict}
  frames {frames_a_second:.1f} a second; between two {frame_ms_median:.0f} ms median, \
{frame_ms_95:.0f} ms 95 %, {frame_ms_worst:.0f} ms worst
  drawn {drawn}, of that what is still {still_drawn}; pictures {pictures}, events {events}
  stream {stream:.0f} kB a second, fetched {fetched_mb:.1f} MB
  CPU of Chromium {page_cpu_share:.2f}, of that the page {renderer_cpu_share:.2f}; \
of the service {service_cpu_share:.2f} cores
  memory: Chromium {page}, heap of the page {heap}, service {service}"""


def main() -> int:
    """Runs it; exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--positioners", type=int, nargs="+", default=[500, 5000])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    parser.add_argument("--out", type=Path, metavar="FILE.json")
    asked = parser.parse_args()
    from playwright.sync_api import sync_playwright

    results = []
    with sync_playwright() as playwright:
        browser = launched(playwright)
        for positioners in asked.positioners:
            results.append(measure(browser, positioners, asked.seconds, asked.pictures))
            print(told(results[-1]), flush=True)
        browser.close()
    if asked.out is not None:
        asked.out.write_text(json.dumps(results, indent=1) + "\n")
    return 0 if all(is_smooth(found) and not found["console"] for found in results) else 1


if __name__ == "__main__":
    sys.exit(main())
