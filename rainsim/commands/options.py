"""Option groups that commands share, and the types of values that have several parts."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import click

from rainsim.config.preset_files import DEFAULT_PRESET
from rainsim.config.tables import SETTINGS

WIDTH = 648  # px, where neither a width nor a height is given
PRESETS = "the preset's"  # shown as the default of options that override a preset


class Numbers(click.ParamType):
    """Numbers separated by commas, such as x,y,z, or one of `words` (with | between them)."""

    name = "numbers"

    def __init__(self, parts, words=""):
        self.parts, self.words = parts.split(","), words

    def get_metavar(self, param, ctx=None):
        """Return how the value is shown in the help."""
        shown = ",".join(self.parts).upper()
        return f"{shown}|{self.words}" if self.words else shown

    def convert(self, value, param, ctx):
        """Return a tuple of floats, or the word itself."""
        if isinstance(value, tuple):
            return value
        if value in self.words.split("|"):
            return value
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != len(self.parts) or not all(map(math.isfinite, numbers)):
            other = f" or {self.words}" if self.words else ""
            self.fail(
                f"{value!r} is not {len(self.parts)} finite numbers {','.join(self.parts)} "
                f"without spaces{other}",
                param,
                ctx,
            )
        return numbers


class FrameRange(click.ParamType):
    """Frames A:B, B not included."""

    name = "A:B"

    def convert(self, value, param, ctx):
        """Return (A, B)."""
        if isinstance(value, tuple):
            return value
        first, colon, end = value.partition(":")
        if not (colon and first.isdecimal() and end.isdecimal()):
            self.fail(f"{value!r} is not a range A:B of frame numbers, such as 0:24", param, ctx)
        return int(first), int(end)


class KnownLength(Numbers):
    """Two points and the metres between them: in space, or in the picture of a camera."""

    name = "length"

    def __init__(self):
        super().__init__("x1,y1,z1,x2,y2,z2,m")
        self._in_picture = Numbers("u1,v1,u2,v2,m")

    def get_metavar(self, param, ctx=None):
        """Return how the value is shown in the help."""
        return "X1,Y1,Z1,X2,Y2,Z2,M|CAMERA:U1,V1,U2,V2,M"

    def convert(self, value, param, ctx):
        """Return the camera's name or None, and a tuple of floats."""
        if isinstance(value, tuple):
            return value
        camera, colon, numbers = value.rpartition(":")
        if colon:
            return camera, self._in_picture.convert(numbers, param, ctx)
        return None, super().convert(value, param, ctx)


FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)


def group(*options):
    """Return several options as one decorator."""

    def decorate(command):
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


scene_option = click.option(
    "--scene",
    "-s",
    default="bicycle",
    show_default=True,
    metavar="NAME|PATH",
    help="A name from `rainsim scenes`, a trained model's folder, a splat file or a scene folder.",
)

ground_options = group(
    click.option(
        "--cameras",
        type=FILE,
        metavar="FILE",
        help="cameras.json or transforms.json instead of the one beside the splats. A camera of "
        "USD, glTF or Blender is taken as --path.",
    ),
    click.option(
        "--photos",
        type=FOLDER,
        metavar="DIR",
        help="Photographs of the capture's cameras, if not in images/ or input/ beside it: their "
        "GPS gives the scale, place and time the captured sun.",
    ),
    click.option(
        "--up",
        type=Numbers("x,y,z"),
        help="Direction that is roughly up, in the capture's own axes.",
    ),
    click.option(
        "--meters-per-unit", type=float, metavar="S", help="Scale: metres per capture unit."
    ),
    click.option(
        "--camera-height",
        type=float,
        metavar="M",
        help="Scale from the cameras' mean height above the ground, in metres. "
        "[default: GPS of the photographs, else 1.8 is assumed, from the air asked for]",
    ),
    click.option(
        "--known-length",
        type=KnownLength(),
        help="Scale from two points and the metres between them: in capture units, or as columns "
        "and rows of a camera's full picture.",
    ),
    click.option(
        "--spz-frame",
        type=click.Choice(["rub", "rdf"]),
        help="Axes of an SPZ file that does not name them: right, up, back or right, down, "
        "forward. [default: those in which its cameras see]",
    ),
    click.option(
        "--fall",
        type=Numbers("percent,direction"),
        help="Slope of the ground in percent, and the direction in which it goes down, in degrees "
        "counter-clockwise from the first camera's view; without it the ground is made level.",
    ),
    click.option(
        "--ground-frame",
        type=FILE,
        metavar="FILE.json",
        help="Up, scale and origin of the ground in one file, as `rainsim import` writes it.",
    ),
)

mask_options = group(
    click.option(
        "--class-mask",
        type=FILE,
        metavar="FILE.png",
        help="Classes painted in the colours of classes.png; black is left to the program.",
    ),
    click.option(
        "--water-mask",
        type=FILE,
        metavar="FILE.png",
        help="Water at the start: a grey picture of the height map's cells, its value the depth "
        "in mm.",
    ),
    click.option(
        "--water-mask-use",
        type=click.Choice(["stays", "drains"]),
        default="stays",
        show_default=True,
        help="stays: the ground is dented by the depth, so that the water stays; drains: it is "
        "poured, and stands where the ground dips.",
    ),
)

eye_options = group(
    click.option("--eye", type=Numbers("x,y,z"), help="Where to look from, in capture units."),
    click.option("--look-at", type=Numbers("x,y,z"), help="Where to look to, in capture units."),
)

shot_options = group(
    click.option("--path-camera", metavar="NAME",
                 help="Which camera of a USD or glTF file with several: its name or whole path."),
    click.option("--path-in", type=click.Choice(["ground", "capture"]), show_default="ground",
                 help="Coordinates of a camera of USD, glTF or Blender: ground, those that "
                 "`rainsim world` writes, in metres with z up; capture, the splats' own, and the "
                 "numbers count as they stand."),
)  # fmt: skip

camera_options = group(
    click.option(
        "--camera",
        metavar="NAME",
        help="A camera of the capture. [default: the one that shows most water]",
    ),
    click.option(
        "--path",
        type=FILE,
        metavar="FILE",
        help="A camera path, one camera per frame: transforms.json, a camera_path.json of "
        "`rainsim view` or nerfstudio, or a camera of USD, glTF or Blender. A single camera stands "
        "still for --frames.",
    ),
    shot_options,
    click.option(
        "--orbit",
        is_flag=True,
        help="A full circle around the point that the capture's cameras look at.",
    ),
    click.option(
        "--drive", is_flag=True, help="The capture's own cameras in their order, one per frame."
    ),
    eye_options,
    click.option(
        "--fov",
        type=float,
        metavar="DEG",
        help="Horizontal field of view with --eye, in degrees. [default: 60]",
    ),
)

preset_option = click.option(
    "--preset",
    "-p",
    metavar="NAME|FILE.toml",
    default=DEFAULT_PRESET,
    show_default=True,
    help="A name from `rainsim presets`, or a file of such settings.",
)

PANELS = {  # group of settings: its options, where a setting names no others
    "rain": "rain", "water": "rain", "render": "light", None: "rain", "terrain": "terrain",
}  # fmt: skip


def _of_setting(name, text=""):
    """Return the option of a setting; `text` is a help text in place of its own."""
    setting, option = SETTINGS[name], SETTINGS[name].option
    kind, metavar = str, option.metavar
    if len(setting.keys) > 1:
        parts, _, words = metavar.partition("|")
        kind, metavar = Numbers(parts.lower(), words), None
    elif setting.kind.startswith(("float", "int")):
        kind = float if setting.is_number else int
    text, unit = text or option.help or setting.keys[0].meaning, setting.keys[0].unit
    if unit and unit not in (word.strip(",;:") for word in text.split()):
        text = re.sub("[:;]|$", f", in {unit}\\g<0>", text, count=1)
    if text.split()[0].rstrip(":") not in setting.choices:
        text = text[0].upper() + text[1:]
    return click.option(f"--{option.name.replace('_', '-')}", type=kind, metavar=metavar,
                        show_default=option.default, help=f"{text}.")  # fmt: skip


def _of_panel(panel):
    """Return the options of the settings that belong to a panel, as one decorator."""
    own = {name: one.option.panel or PANELS[one.group]
           for name, one in SETTINGS.items() if one.option}  # fmt: skip
    return group(*(_of_setting(name) for name, its in own.items() if its == panel))


rain_options = _of_panel("rain")
light_options = _of_panel("light")
big_options = _of_panel("big")
terrain_options = _of_panel("terrain")
ground_map_option = _of_panel("ground_map")
shower_options = group(  # for commands whose --rain takes several rates
    _of_setting("past", "Rain that fell before and stands in puddles, in mm; none for 0 mm/h"),
    _of_setting("wind", "Wind in m/s and the direction in which the air moves, in degrees"),
    _of_setting("seed"),
)

size_options = _of_panel("picture")
picture_options = group(
    size_options,
    click.option("--video", is_flag=True,
                 help="Also write video.mp4, or video.mov for ProRes (needs rainsim[video])."),
    click.option("--video-codec", type=click.Choice(["h264", "h265", "prores"]),
                 show_default="h264",
                 help="With --video: h264 plays everywhere; h265 takes less space; prores, 422 HQ "
                 "of 10 bits, is for editing and large."),
    click.option("--video-quality", type=click.IntRange(0, 100), metavar="0..100",
                 show_default="the codec's: h264 82, h265 70, prores the rate of 422 HQ",
                 help="With --video: higher is better and larger. For h264 and h265 it is a CRF of "
                 "51 - N/2: 66 is CRF 18, which looks lossless, 56 is CRF 23. For prores it is a "
                 "quantiser of 64^(1 - N/100)."),
    click.option("--layers", metavar="all|NAME,NAME", show_default="none",
                 help="Also write parts of each frame for compositing, such as depth,water_depth."),
    click.option("--exr", is_flag=True,
                 help="Also write one OpenEXR file a frame, in linear light, with all that it is "
                 "composed of (needs rainsim[exr])."),
    click.option("--exr-name", metavar="NAME.%04d.exr", show_default="rain.%04d.exr",
                 help="With --exr: name of the files, with the place of the frame's number."),
    click.option("--frame-start", type=click.IntRange(0, 10**8), metavar="N",
                 show_default="the path's, or 0",
                 help="With --exr and --video: number of the first frame, in names, headers and "
                 "time code."),
    click.option("--colorspace", type=click.Choice(["rec709", "acescg"]), show_default="rec709",
                 help="With --exr: of the light in it, linear Rec. 709 or ACEScg."),
)  # fmt: skip

range_option = click.option(
    "--frame-range",
    type=FrameRange(),
    show_default="all",
    help="Only frames A to B, B excluded; the water is still simulated from frame 0 on.",
)

shared_range_option = click.option(
    "--frame-range",
    type=FrameRange(),
    show_default="all",
    help="Only frames A to B, B excluded. Other processes, here or on other machines, may draw "
    "other ranges of the same run into the same folder; who finishes its last frame completes it. "
    "A frame has one owner: with --resume what an ended process left undone is drawn.",
)

farm_options = group(
    click.option(
        "--workers",
        type=click.IntRange(1, 4096),
        metavar="N",
        help="Draw in N processes on this machine, each with its share of the cores, or a GPU of "
        "its own (needs rainsim[farm]).",
    ),
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Draw by the workers of a dask scheduler, such as tls://host:8786 (needs "
        "rainsim[farm]).",
    ),
)


def output_options(default):
    """Return the options of a command that fills a folder; `default` is shown for --out."""
    return group(
        click.option("--out", "-o", type=FOLDER, metavar="DIR", show_default=default,
                     help="Output folder."),
        click.option("--overwrite", is_flag=True,
                     help="Allow a folder that is not empty; only earlier results that its record "
                     "lists are replaced."),
        threads_option,
        json_option,
        click.option("--quiet", "-q", is_flag=True, help="Print errors only."),
    )  # fmt: skip


resume_option = click.option(
    "--resume", is_flag=True,
    help="Go on with an unfinished run in the output folder: frames and states that are finished "
    "are kept after a check. Anything but the very same run is refused.",
)  # fmt: skip

backend_option = click.option(
    "--backend", type=click.Choice(["cpu", "cuda"]), default="cpu", show_default=True,
    help="What computes: cuda needs an NVIDIA GPU and rainsim[cuda]; see `rainsim doctor`.",
)  # fmt: skip

json_option = click.option("--json", "as_json", is_flag=True, help="Print results as JSON.")

threads_option = click.option(
    "--threads", type=int, metavar="N", show_default="all cores", help="Number of threads."
)


def echo(result, as_json, text):
    """Print a command's result: plain values as JSON, or the text that stands for them."""
    click.echo(json.dumps(result, indent=1) if as_json else text)


def default_out(*names):
    """Return the output folder when none was given."""
    return Path("rainsim-out") / "-".join(plain(name) for name in names)


def plain(name):
    """Return a name with characters replaced that do not belong in a folder's name."""
    return "".join(c if c.isalnum() or c in "._-" else "-" for c in name).strip(".-") or "scene"
