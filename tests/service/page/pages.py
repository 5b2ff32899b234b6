"""Pages in a real browser: opened, watched for errors, clicked."""

import contextlib
import socket

from benchmarks.page.chromium import SIZE
from served import HOST


def bound(port=0):
    """A socket for the service, of a free port by default."""
    made = socket.socket()
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    made.bind((HOST, port))
    return made


@contextlib.contextmanager
def visitor(browser, url, cut=False, **how):
    """A page that was opened and is live; no error of any kind, and nothing from elsewhere, until its end."""
    wrong = []
    context = browser.new_context(viewport=SIZE, **how)
    page = context.new_page()
    page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("request", lambda r: None if r.url.startswith(url) else wrong.append(f"elsewhere: {r.url}"))
    page.goto(url)
    yield page
    context.close()
    if cut:  # a connection that is refused meanwhile is told by the browser itself
        wrong = [text for text in wrong if "ERR_CONNECTION" not in text and "WebSocket" not in text]
    assert wrong == []


def click_fibre(page, row):
    """A click where the fibre of a positioner is drawn."""
    x, y = page.evaluate(
        "(row) => { const { view, model } = window.fiberloom, tip = model.plane.arm(row).slice(6);"
        " const box = document.querySelector('#moving').getBoundingClientRect();"
        " return [box.left + view.px(tip[0]) / view.ratio, box.top + view.py(tip[1]) / view.ratio]; }",
        row,
    )
    page.mouse.click(x, y)
