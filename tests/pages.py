"""`rainsim view` in a process of its own, and what a user does on its page."""

import base64
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager

import imageio.v3 as imageio
import numpy as np

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# WebGL without a GPU; as root a browser needs to be allowed to run without its sandbox.
ARGUMENTS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
ROOT = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
# Notes each picture that the page uploads as a texture, and when the next frame was begun. Depth
# comes as PNG, pictures come as JPEG.
HOOK = """
window.pictures = [];
const blobs = new Map(), create = URL.createObjectURL;
URL.createObjectURL = function (blob) {
  const url = create.call(URL, blob);
  blobs.set(url, blob);
  return url;
};
for (const name of ["texImage2D", "texSubImage2D"]) {
  const upload = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    const image = given[given.length - 1], blob = image && blobs.get(image.src);
    if (blob) {
      blobs.delete(image.src);
      const entry = {width: image.naturalWidth, height: image.naturalHeight, uploaded:
        performance.now(), shown: null};
      requestAnimationFrame(() => { entry.shown = performance.now(); });
      blob.slice(0, 1).arrayBuffer().then(start => {
        if (new Uint8Array(start)[0] === 0xff) {
          window.pictures.push(entry);
          window.lastPicture = image;
        }
      });
    }
    return upload.apply(this, given);
  };
}
"""
PIXELS = """() => {
  const canvas = document.createElement("canvas"), image = window.lastPicture;
  canvas.width = image.naturalWidth; canvas.height = image.naturalHeight;
  const context = canvas.getContext("2d");
  context.drawImage(image, 0, 0);
  const data = context.getImageData(0, 0, canvas.width, canvas.height).data;
  const text = Array.from(data, v => String.fromCharCode(v)).join("");
  return [canvas.width, canvas.height, btoa(text)];
}"""


def program_of():
    """Return the path of a browser that is installed here, None without one."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def free_port():
    """Return a port that nobody listens on."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@contextmanager
def viewing(*arguments, folder=None):
    """Run `rainsim view` and yield its process and address; end it by Ctrl-C."""
    command = [sys.executable, "-m", "rainsim", "view", *map(str, arguments)]
    process = subprocess.Popen(
        [*command, "--port", str(free_port())], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, cwd=folder,
        # a shell that runs the tests in the background has all below it ignore the signal
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    try:
        address = process.stdout.readline().strip().partition("/?")[0]  # with all its pixels
        assert address.startswith("http://127.0.0.1:"), process.communicate(timeout=60)[1]
        yield process, address
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)


class Page:
    """A page of the browser with what a user does on it."""

    def __init__(self, browser, address, size=(1000, 700)):
        self.context = browser.new_context(viewport={"width": size[0], "height": size[1]})
        self.page = self.context.new_page()
        self.page.add_init_script(HOOK)
        self.page.goto(address)
        self.wait_for_pictures()

    def pictures(self):
        """Return the pictures that the page has shown, oldest first."""
        return [p for p in self.page.evaluate("window.pictures") if p["shown"] is not None]

    def wait_for_pictures(self, more=1, seconds=60.0):
        """Wait until so many more pictures are shown."""
        count, end = len(self.pictures()), time.monotonic() + seconds
        while len(self.pictures()) < count + more:
            assert time.monotonic() < end, f"{len(self.pictures())} pictures"
            self.page.wait_for_timeout(20)

    def wait_until(self, done, seconds=60.0):
        """Wait until done() is true."""
        end = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < end
            self.page.wait_for_timeout(50)

    def settle(self, width=400, seconds=60.0):
        """Wait until the finished picture is shown and no other follows."""
        end = time.monotonic() + seconds
        self.wait_until(lambda: (p := self.pictures()) and p[-1]["width"] == width, seconds)
        count, quiet = -1, 0
        while quiet < 3:
            before, count = count, len(self.pictures())
            quiet = quiet + 1 if before == count and self.says("finished: ") else 0
            self.page.wait_for_timeout(600)
            assert time.monotonic() < end, self.page.inner_text("body")

    def says(self, text):
        """Return whether a text stands on the page."""
        return text in self.page.inner_text("body")

    def pixels(self):
        """Return the last picture that was uploaded, ndarray of shape (height, width, 3), uint8."""
        width, height, text = self.page.evaluate(PIXELS)
        pixels = np.frombuffer(base64.b64decode(text), np.uint8)
        return pixels.reshape(height, width, 4)[..., :3].astype(int)

    def differs(self, before):
        """Return whether the last picture differs from an earlier one."""
        now = self.pixels()
        return now.shape != before.shape or bool((now != before).any())

    def screen(self):
        """Return what the page looks like, ndarray of shape (height, width, 3), uint8."""
        return imageio.imread(self.page.screenshot())[..., :3]

    def when_still(self, look, seconds=30.0):
        """Return what look() returns as soon as it is the same three times."""
        end, seen = time.monotonic() + seconds, [look()]
        while len(seen) < 3 or any((one != seen[-1]).any() for one in seen[-3:]):
            assert time.monotonic() < end
            self.page.wait_for_timeout(200)
            seen.append(look())
        return seen[-1]

    def drag(self, dx=60, dy=0, steps=6, pause=0):
        """Turn the camera by a drag on the picture."""
        mouse = self.page.mouse
        mouse.move(350, 350)
        mouse.down()
        for n in range(1, steps + 1):
            mouse.move(350 + dx * n / steps, 350 + dy * n / steps)
            if pause:
                self.page.wait_for_timeout(pause)
        mouse.up()

    def type_into(self, label, value):
        """Type a value into the control of a label."""
        field = self.field(label)
        field.fill(str(value))
        field.press("Enter")
        self.pause()

    def choose(self, label, option):
        """Choose an option of the dropdown of a label."""
        self.field(label).click(force=True)  # the panel may be growing
        self.page.get_by_role("option", name=option, exact=True).click(force=True)
        self.pause()

    def tick(self, label):
        """Click the checkbox of a label."""
        self.field(label).click(force=True)
        self.pause()

    def pause(self):
        """Wait as long as a hand needs: of controls changed faster viser's page sends the last."""
        self.page.wait_for_timeout(200)

    def field(self, label):
        """Return the input of a label; of a slider the one that takes numbers."""
        found = self.page.locator("label", has_text=re.compile(f"^{re.escape(label)}$")).first
        own = self.page.locator(f"[id='{found.get_attribute('for')}']")
        if own.evaluate("e => e.tagName") == "INPUT":
            return own
        return found.locator("xpath=../../..").locator("input[type=text]").last

    def open_folder(self, name):
        """Open a folder of controls."""
        self.page.get_by_text(name, exact=True).first.click()
        self.page.wait_for_timeout(300)

    def press(self, label):
        """Press a button."""
        self.page.get_by_role("button", name=label, exact=True).click()

    def close(self):
        """Close the page."""
        self.context.close()
