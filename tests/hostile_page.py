"""A page that is no browser: it speaks viser's messages, and sends what no browser would."""

import threading
import time
import urllib.request

import numpy as np

LEVEL = {
    "type": "ViewerCameraMessage", "wxyz": [0.5, -0.5, 0.5, -0.5], "position": [0.0, -2.0, 1.5],
    "fov": 1.0, "near": 0.01, "far": 1000.0, "image_height": 480, "image_width": 720,
    "look_at": [0.0, 0.0, 0.0], "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip
VALUES = (
    0, -1, 1, 0.5, 1e-300, 1e300, -1e300, 1e30, float("nan"), float("inf"), 2**62, -(2**62), True,
    None, "", "x", "1e300", "\x1b[31m", "a" * 9000, [], [0, 0, 0, 0], [0, 0, 0], [1e300, 0, 0],
    [None] * 4, {}, {"a": 1}, {"value": 1e300}, b"", b"\0" * 100, [[0.5, 0.5]], [[9, 9]], [[]],
)  # fmt: skip


class HostilePage:
    """A connection to a page's server.

    Attributes
    ----------
    controls : dict of str to str
        Kind of each control by its identifier, as the server announced them.
    notes : list of str
        What the server showed in notifications.
    pictures : int
        That it was shown.
    """

    def __init__(self, port):
        import viser
        from websockets.sync.client import connect

        self.controls, self.notes, self.pictures, self.closed = {}, [], 0, False
        self._socket = connect(
            f"ws://127.0.0.1:{port}", subprotocols=[f"viser-v{viser.__version__}"],
            compression=None, max_size=None, close_timeout=2,
        )  # fmt: skip
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        from websockets.exceptions import ConnectionClosed

        try:
            for raw in self._socket:
                self._take(raw)
        except ConnectionClosed:
            pass
        self.closed = True

    def _take(self, raw):
        for message in messages_in(raw):
            kind = message.get("type", "")
            if kind.startswith("Gui") and "props" in message:
                self.controls[message["uuid"]] = kind
            self.pictures += kind == "BackgroundImageMessage" and message["rgb_data"] is not None
            if kind == "NotificationShowMessage":
                self.notes.append(str(message))

    def send(self, message):
        """Send a message, a dict or bytes; return whether the connection took it."""
        import msgspec
        from websockets.exceptions import ConnectionClosed

        try:
            self._socket.send(message if isinstance(message, bytes) else
                              msgspec.msgpack.encode(message))  # fmt: skip
        except ConnectionClosed:
            return False
        return True

    def wait_for(self, done, seconds=10.0):
        """Wait until done() is true; return whether it came true."""
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            time.sleep(0.02)
        return done()

    def close(self):
        """Leave."""
        self._socket.close()


def messages_in(raw):
    """Return the messages of what a server sent at once: a head of two lengths, packed msgpack."""
    import msgspec
    import zstandard

    length = int.from_bytes(raw[8:16], "little")
    inner = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + length])
    return msgspec.msgpack.decode(inner)["messages"]


def hostile_messages(rng, controls, count):
    """Yield messages with one or more values that no browser sends, and bytes that are none."""
    controls = sorted(controls) or ["none"]
    shapes = [
        LEVEL,
        {"type": "ScenePointerMessage", "event_type": "click", "ray_origin": [0, 0, 0],
         "ray_direction": [0, 1, 0], "screen_pos": [[0.5, 0.5]], "modifier": None},
        {"type": "TransformControlsUpdateMessage", "name": "/up", "wxyz": [1, 0, 0, 0],
         "position": [0, 0, 0], "owner": ""},
        {"type": "FileTransferStartUpload", "source_component_uuid": "?", "transfer_uuid": "t",
         "filename": "a.json", "mime_type": "application/json", "part_count": 1, "size_bytes": 9},
        {"type": "FileTransferPart", "source_component_uuid": "?", "transfer_uuid": "t",
         "part_index": 0, "content": b"123456789"},
    ]  # fmt: skip
    for _ in range(count):
        kind = rng.integers(4)
        if kind < 2:
            value = VALUES[rng.integers(len(VALUES))]
            uuid = controls[rng.integers(len(controls))]
            yield {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
            continue
        message = dict(shapes[rng.integers(len(shapes))])
        for key in ("source_component_uuid",):
            if key in message:
                message[key] = controls[rng.integers(len(controls))]
        for _ in range(rng.integers(1, 3)):
            key = sorted(message)[rng.integers(len(message))]
            message[key] = VALUES[rng.integers(len(VALUES))]
            if rng.random() < 0.1:
                del message[key]
        if kind == 3 and rng.random() < 0.3:
            yield bytes(rng.integers(0, 256, rng.integers(0, 60), dtype=np.uint8))
        yield message


def serves(port):
    """Return whether the page itself is still served."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=20) as answer:
        return answer.status == 200
