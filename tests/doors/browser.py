"""browser.py - drives a headless Chromium through its DevTools protocol, over a pipe."""
import base64
import json
import os
import shutil
import subprocess
import tempfile

# Without a GPU, SwiftShader draws WebGL.
COMMAND = ["chromium", "--headless", "--no-sandbox", "--use-angle=swiftshader", "--disable-extensions",
           "--enable-unsafe-swiftshader", "--no-first-run", "--remote-debugging-pipe", "--hide-scrollbars"]


class Browser:
    def __init__(self, width=1280, height=1000):
        to_read, self.to_write = os.pipe()
        self.to_read, to_write = os.pipe()
        self.profile = tempfile.mkdtemp()

        def descriptors():  # Chromium reads from 3 and writes to 4
            os.dup2(to_read, 63), os.dup2(to_write, 62)
            os.dup2(63, 3), os.dup2(62, 4)

        self.process = subprocess.Popen(
            COMMAND + ["--user-data-dir=" + self.profile, f"--window-size={width},{height}"],
            preexec_fn=descriptors, close_fds=False, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(to_read), os.close(to_write)
        self.number, self.rest, self.session, self.problems = 0, b"", None, []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in "Page", "Runtime", "Log":
            self.call(domain + ".enable")

    def message(self):
        while b"\0" not in self.rest:
            got = os.read(self.to_read, 1 << 20)
            if not got:
                raise EOFError("Chromium ended")
            self.rest += got
        text, self.rest = self.rest.split(b"\0", 1)
        return json.loads(text)

    def call(self, method, **params):
        self.number += 1
        request = {"id": self.number, "method": method, "params": params}
        if self.session:
            request["sessionId"] = self.session
        os.write(self.to_write, json.dumps(request).encode() + b"\0")
        while True:
            got = self.message()
            self.note(got.get("method"), got.get("params", {}))
            if got.get("id") == self.number:
                if "error" in got:
                    raise RuntimeError(f"{method}: {got['error']}")
                return got["result"]

    # Keeps what a person would see as an error in the console.
    def note(self, method, params):
        if method == "Runtime.exceptionThrown":
            self.problems.append(str(params["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning", "assert"):
            self.problems.append(str(params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.problems.append(str(params["entry"]))

    def js(self, text):
        got = self.call("Runtime.evaluate", expression=text, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in got:
            raise RuntimeError(f"{text}: {got['exceptionDetails']}")
        return got["result"].get("value")

    def open(self, path):
        self.problems = []
        self.call("Page.navigate", url="file://" + os.path.abspath(path))
        return self.js("""new Promise((done, fail) => {
            const end = Date.now() + 600000;
            const look = () => document.body?.dataset.ready ? done(document.body.dataset.ready) :
                Date.now() > end ? fail(Error("not ready: " + location)) : setTimeout(look, 50);
            look(); })""")

    def key(self, key, code=0):
        for kind in "keyDown", "keyUp":
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)

    def screenshot(self, path):
        got = self.call("Page.captureScreenshot", captureBeyondViewport=True)
        with open(path, "wb") as file:
            file.write(base64.b64decode(got["data"]))

    def pdf_bytes(self):
        return len(base64.b64decode(self.call("Page.printToPDF", printBackground=True)["data"]))

    def close(self):
        self.process.kill()
        self.process.wait()
        shutil.rmtree(self.profile, ignore_errors=True)
