"""Messages of a page, checked before any value of them is kept.

viser keeps the value of a control and the place of a camera as a page sends them, hands them to
its callbacks, and shows them to all pages that come later. A value that cannot be is dropped here,
at the socket, and that page shows why.
"""

import math
import time
from weakref import WeakKeyDictionary

import numpy as np

from rainsim.errors import ParameterError, RainsimError, shown
from rainsim.io.files import json_number, number_array
from rainsim.scene.camera_rule import MAX_SIDE, RIGID_TOLERANCE, focal_length, require_camera
from rainsim.scene.types import Camera

MOST_TEXT = 4096  # characters of a name
MOST_BYTES = 8 << 20  # of a message; viser sends files in parts of half a megabyte
MOST_FILE = 64 << 20  # bytes of an upload: a camera path of the most frames has half of it
MOST_UPLOADS = 4  # that have begun and not ended, of all pages
WORDS_EVERY = 1.0  # s between complaints to one page
FOV = "give the window another shape, or the camera another angle"


class UnfinishedError(ParameterError):
    """A fault that passes by itself: a number below a control's least while one types 640, say."""


def _is_text(value):
    return isinstance(value, str) and len(value) <= MOST_TEXT


def _is_place(value):
    return number_array(value, (3,)) is not None


def _is_turn(value):
    turn = number_array(value, (4,))
    return turn is not None and abs(np.linalg.norm(turn) - 1) < RIGID_TOLERANCE


def _is_number(value):
    return json_number(value) is not None


def _is_count(value):
    return type(value) is int and 0 <= value <= MOST_FILE


def _is_side(value):
    return type(value) is int and 1 <= value <= MAX_SIDE


def _is_click(value):
    place = number_array(value, (1, 2))
    return place is not None and bool((np.abs(place - 0.5) <= 0.5).all())


_NODE = {"name": _is_text}
FIELDS = {  # of the messages that this program's page sends; others are dropped
    "ViewerCameraMessage": {
        "wxyz": _is_turn, "position": _is_place, "look_at": _is_place, "up_direction": _is_place,
        "fov": lambda v: _is_number(v) and 0 < v < math.pi, "near": _is_number, "far": _is_number,
        "image_width": _is_side, "image_height": _is_side,
    },
    "GuiUpdateMessage": {
        "uuid": _is_text, "updates": lambda v: isinstance(v, dict) and list(v) == ["value"],
    },
    "ScenePointerMessage": {
        "event_type": lambda v: v == "click", "ray_origin": _is_place, "ray_direction": _is_place,
        "screen_pos": _is_click,
    },
    "TransformControlsUpdateMessage": _NODE | {"wxyz": _is_turn, "position": _is_place},
    "TransformControlsDragStartMessage": _NODE,
    "TransformControlsDragEndMessage": _NODE,
    "FileTransferStartUpload": {
        "source_component_uuid": _is_text, "transfer_uuid": _is_text, "filename": _is_text,
        "mime_type": _is_text, "part_count": _is_count, "size_bytes": _is_count,
    },
    "FileTransferPart": {
        "source_component_uuid": _is_text, "transfer_uuid": _is_text, "part_index": _is_count,
        "content": lambda v: isinstance(v, bytes),
    },
}  # fmt: skip


def require_values(kind, values):
    """Raise ParameterError unless a decoded message has the values that its kind must have."""
    if 0 in (values.get("image_width"), values.get("image_height")):
        raise UnfinishedError("the page has no size yet")
    for name, fits in FIELDS[kind].items():
        if not fits(values.get(name)):
            raise ParameterError(
                f"the page sent {name} {shown(values.get(name))}; that is no value of {kind}; "
                "load the page again"
            )
    if not _is_text(values.get("owner", "")):
        raise ParameterError(f"the page sent {kind} of no owner; load the page again")
    if kind == "ViewerCameraMessage":
        sides = values["image_width"], values["image_height"]
        focal = focal_length(sides[1], values["fov"])
        camera = Camera(*sides, focal, focal, sides[0] / 2, sides[1] / 2, np.eye(4))
        require_camera(camera, "the page's camera", ParameterError, FOV)


def require_value(control, value):
    """Raise ParameterError unless a control can have a value; a page alone keeps to its limits."""
    options, low, high = (getattr(control, name, None) for name in ("options", "min", "max"))
    now = getattr(control, "value", None)
    if getattr(control, "disabled", False):
        fits, rule = False, "left alone until it is enabled"
    elif options is not None:
        fits, rule = isinstance(value, str) and value in options, f"one of {', '.join(options)}"
    elif isinstance(now, bool):
        fits, rule = isinstance(value, bool), "on or off"
    elif isinstance(now, int | float):
        low, high = (-1e12 if low is None else low), (1e12 if high is None else high)
        fits, rule = _is_number(value) and low <= value <= high, f"from {low:g} to {high:g}"
    else:
        fits, rule = False, "nothing that a page sends"
    if not fits and low is not None and _is_number(value) and 0 <= value < low:
        raise UnfinishedError("there is more to be typed")
    if not fits:
        label = getattr(control, "label", "a control")
        raise ParameterError(f"{label} is {shown(value)}; it must be {rule}; type another value")


def require_upload(control):
    """Raise ParameterError unless a control takes files: viser gives any control an upload."""
    if not hasattr(getattr(control, "value", None), "content"):
        raise ParameterError(
            f"{getattr(control, 'label', 'a control')} takes no file; load the page again"
        )


class Uploads:
    """The files that pages have begun to send, bounded in number and in size."""

    def __init__(self):
        self._left = WeakKeyDictionary()  # of each connection: bytes still to come, by transfer

    def receive(self, connection, kind, values):
        """Note a message of a file; raise ParameterError if it is too large or there are many."""
        own, name = self._left.setdefault(connection, {}), values["transfer_uuid"]
        if kind == "FileTransferStartUpload":
            if sum(map(len, self._left.values())) >= MOST_UPLOADS:
                raise ParameterError(
                    f"{MOST_UPLOADS} files are on their way already; there may be no more; wait, "
                    "or load the pages again that send them"
                )
            if values["size_bytes"] > 0:
                own[name] = values["size_bytes"]
            return
        left = own.pop(name, -1) - len(values["content"])
        if left < 0:
            raise ParameterError("the page sent more of a file than it has; load the page again")
        if left:
            own[name] = left


class Checks:
    """The socket's side of one server: checks the messages that its connections receive."""

    def __init__(self):
        self.controls, self.complain, self._uploads = lambda: (), lambda *_: None, Uploads()

    def passes(self, connection, raw):
        """Return whether a message may be handed on; complain of it if not."""
        import msgspec
        from viser._messages import Message

        try:
            values = msgspec.msgpack.decode(raw)
            kind = values.pop("type") if isinstance(values, dict) else None
            if not isinstance(kind, str) or kind not in FIELDS:
                return False
            require_values(kind, values)
            uuid = values.get("uuid", values.get("source_component_uuid"))
            control = None if uuid is None else self._control(uuid)
            if uuid is not None and control is None:  # it was removed meanwhile
                return False
            if kind == "GuiUpdateMessage":
                require_value(control, values["updates"]["value"])
            elif uuid is not None:
                require_upload(control)
                self._uploads.receive(connection, kind, values)
            Message.deserialize(raw)
        except UnfinishedError:
            return False
        except RainsimError as error:
            self.complain(connection, error)
            return False
        except Exception:  # of the decoder: a page that is ours sends no such bytes
            return False
        return True

    def _control(self, uuid):
        found = (known.get(uuid) for known in self.controls())
        return next((one for one in found if one is not None), None)


def connections_of(checks):
    """Return the class of a server's connections that hand on only messages that pass `Checks`."""
    from websockets.asyncio.server import ServerConnection

    class Connection(ServerConnection):
        last_shown = -math.inf

        async def recv(self, *given, **named):
            while True:
                raw = await super().recv(*given, **named)
                if isinstance(raw, bytes) and checks.passes(self, raw):
                    return raw

    return Connection


def may_show(connection):
    """Return whether a page may show another error; each shows at most one a second."""
    now = time.monotonic()
    if now - connection.last_shown < WORDS_EVERY:
        return False
    connection.last_shown = now
    return True
