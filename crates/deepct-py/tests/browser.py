"""A browser without a window, in which a script examines a page.

    python browser.py PAGE.html

prints how many frames a second the 3D view of a page draws while it turns, without a graphics
processor, and the processor time of a frame, which tells on a busy machine how many there could be
(Linux only). Chromium is needed.
"""

import http.server
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

OPTIONS = (
    "--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--no-first-run", "--disable-component-update",
    "--disable-sync", "--window-size=1280,1150",
)

# Errors of the page are kept in `problems` and the texts of its canvases in `texts`; `answer` sends a result and ends the run.
HEAD = """<script>
window.problems = [];
window.texts = [];
const { fillText } = CanvasRenderingContext2D.prototype;
CanvasRenderingContext2D.prototype.fillText = function (text, ...place) {
  texts.push(text);
  fillText.call(this, text, ...place);
};
window.onerror = message => { problems.push(String(message)); };
console.error = (...words) => { problems.push(words.join(' ')); };
const frame = () => new Promise(requestAnimationFrame);
// The volumes of a page are decompressed before they are shown.
const ready = async () => {
  while (document.getElementById('stage') && !document.querySelector('canvas.slice')) await frame();
};
const answer = found => fetch('/answer', { method: 'POST', body: JSON.stringify(found) });
</script>"""

FRAMES = """
const view = document.querySelector('canvas.view');
const turn = () => view.dispatchEvent(
  new PointerEvent('pointermove', { buttons: 1, movementX: 6, movementY: 0 }));
const cpu = async () => Number(await (await fetch('/cpu')).text());
for (let count = 0; count < 40; count++) { turn(); await frame(); }
const used = await cpu(), began = performance.now();
for (let count = 0; count < 120; count++) { turn(); await frame(); }
return { rate: 120000 / (performance.now() - began), cpu: (await cpu() - used) / 120 };
"""


def processor_time(session):
    """The processor time (s) of the processes of a session."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session:
            ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def examine(page, script, limit_s=120):
    """Run a script, the body of an asynchronous function, in a page and return what it returns."""
    text = Path(page).read_text(encoding="utf-8")
    script = (
        "<script>window.addEventListener('load', async () => {"
        f"try {{ await ready(); answer(await (async () => {{ {script} }})()); }}"
        "catch (error) { answer({ error: String(error.stack) }); } });</script>"
    )
    text = text.replace("<head>", "<head>" + HEAD, 1).replace("</body>", script + "</body>")
    found, done = [], threading.Event()

    class Handler(http.server.BaseHTTPRequestHandler):
        def respond(self, body=b""):
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(body)

        def do_GET(self):
            pages = {"/": lambda: text, "/cpu": lambda: str(processor_time(browser.pid))}
            self.respond(pages.get(self.path, str)().encode())

        def do_POST(self):
            found.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.respond()
            done.set()

        def log_message(self, *arguments):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = subprocess.Popen(
            [CHROMIUM, *OPTIONS, f"--user-data-dir={profile}",
             f"http://127.0.0.1:{server.server_port}/"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        try:
            answered = done.wait(limit_s)
        finally:
            browser.terminate()
            browser.wait(30)
            server.shutdown()
            server.server_close()
    if not answered:
        raise TimeoutError(f"the page did not answer within {limit_s} s")
    if isinstance(found[0], dict) and "error" in found[0]:
        raise RuntimeError(found[0]["error"])
    return found[0]


if __name__ == "__main__":
    if CHROMIUM is None:
        sys.exit("browser.py: there is no chromium on the PATH: install it")
    found = examine(sys.argv[1], FRAMES)
    print(f"{found['rate']:.1f} frames a second, {1000 * found['cpu']:.0f} ms of processors for each")
