"""A browser without a window, in which a script examines a page.

    python browser.py PAGE.html

prints how many frames a second the 3D view of a page draws while it turns, without a graphics
processor. Chromium is needed.
"""

import http.server
import json
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

# Errors of the page are kept in `problems`; `answer` sends a result and ends the run.
HEAD = """<script>
window.problems = [];
window.onerror = message => { problems.push(String(message)); };
console.error = (...words) => { problems.push(words.join(' ')); };
const frame = () => new Promise(requestAnimationFrame);
const answer = found => fetch('/answer', { method: 'POST', body: JSON.stringify(found) });
</script>"""

FRAMES = """
const view = document.querySelector('canvas.view');
const turn = () => view.dispatchEvent(
  new PointerEvent('pointermove', { buttons: 1, movementX: 6, movementY: 0 }));
for (let count = 0; count < 40; count++) { turn(); await frame(); }
const began = performance.now();
for (let count = 0; count < 120; count++) { turn(); await frame(); }
return 120000 / (performance.now() - began);
"""


def examine(page, script, limit_s=120):
    """Run a script, the body of an asynchronous function, in a page and return what it returns."""
    text = Path(page).read_text(encoding="utf-8")
    script = (
        "<script>window.addEventListener('load', async () => {"
        f"try {{ answer(await (async () => {{ {script} }})()); }}"
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
            self.respond(text.encode() if self.path == "/" else b"")

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
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
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
    print(f"{examine(sys.argv[1], FRAMES):.1f} frames a second")
